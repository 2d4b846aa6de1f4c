/* Elementary functions built from IEEE operations only (+ - * / sqrt), so that a flight is bit-equal on every machine
 * whatever its C library. Errors: atan2 below 3e-4 deg, sine and cosine below 1e-9. */
#ifndef SAFLITE_EXACT_MATH_H
#define SAFLITE_EXACT_MATH_H

#include <math.h>

/* A function with loops worth the wider registers of newer processors: compiled twice, the loader takes what the machine
 * has. Each element goes through the same IEEE operations, none fused or reordered, so the bits are the same. */
#if defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__) && !defined(EXACT_NARROW)
#define EXACT_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define EXACT_WIDE
#endif

#define EXACT_PI 3.14159265358979323846
#define EXACT_RAD (EXACT_PI / 180.0)

/* Angle of (x, y) in degrees, -180..180, counted from x towards y; 0 for (0, 0). */
static inline float exact_atan2_deg(float y, float x)
{
    const float ax = fabsf(x), ay = fabsf(y);
    const float big = ax > ay ? ax : ay, small = ax > ay ? ay : ax;
    const float q = small / (big + 1e-30f), s = q * q;
    float a = q * (0.99997726f + s * (-0.33262347f + s * (0.19354346f + s * (-0.11643287f + s * (0.05265332f - s * 0.01172120f)))));
    a *= 57.295779513f;
    a = ay > ax ? 90.0f - a : a;
    a = x < 0.0f ? 180.0f - a : a;
    return y < 0.0f ? -a : a;
}

/* Sine and cosine of an angle in radians of any size below 1e8. */
static inline void exact_sincos(double angle, double *sine, double *cosine)
{
    const double turns = floor(angle / (EXACT_PI / 2.0) + 0.5), r = angle - turns * (EXACT_PI / 2.0), s = r * r;
    const double sn = r * (1.0 + s * (-1.0 / 6 + s * (1.0 / 120 + s * (-1.0 / 5040 + s * (1.0 / 362880 - s / 39916800)))));
    const double cs = 1.0 + s * (-0.5 + s * (1.0 / 24 + s * (-1.0 / 720 + s * (1.0 / 40320 - s / 3628800))));
    const int quarter = (int)(turns - 4.0 * floor(turns / 4.0));
    *sine = quarter == 0 ? sn : quarter == 1 ? cs : quarter == 2 ? -sn : -cs;
    *cosine = quarter == 0 ? cs : quarter == 1 ? -sn : quarter == 2 ? -cs : sn;
}

/* The angle brought to -pi..pi. */
static inline double exact_wrap(double angle)
{
    return angle - 2.0 * EXACT_PI * floor(angle / (2.0 * EXACT_PI) + 0.5);
}

static inline double exact_clamp(double value, double least, double most)
{
    return value < least ? least : value > most ? most : value;
}

#endif
