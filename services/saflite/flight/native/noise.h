/* Seeded noise without libm: equal on every machine. Streams are separate, so one sensor's draws never shift another's. */
#ifndef SAFLITE_NOISE_H
#define SAFLITE_NOISE_H

#include <stdint.h>

/* splitmix64 (Steele, Lea, Flood 2014). */
static inline uint64_t noise_bits(uint64_t *state)
{
    uint64_t z = (*state += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

/* Nearly normal, mean 0, variance 1: the sum of four 16-bit uniforms (bounded at 3.46). */
static inline double noise_normal(uint64_t *state)
{
    uint64_t bits = noise_bits(state);
    double sum = (double)(bits & 0xFFFF) + (double)((bits >> 16) & 0xFFFF) + (double)((bits >> 32) & 0xFFFF)
               + (double)(bits >> 48);
    return (sum / 65536.0 - 1.99996948242) * 1.7320508075688772;
}

#endif
