/* MAVLink 2 frames of the simulator's interface (message set common.xml: 107, 113, 65 to PX4, 93 from it). */
#include <math.h>
#include <string.h>

#include "hil.h"

enum { STX_1 = 0xFE, STX_2 = 0xFD, HEADER_2 = 10, HEADER_1 = 6, CRC = 2, SIGNATURE = 13, SIGNED = 1 };
enum { SENSOR = 107, SENSOR_BYTES = 65, SENSOR_EXTRA = 108, GPS = 113, GPS_BYTES = 39, GPS_EXTRA = 124 };
enum { RADIO = 65, RADIO_BYTES = 42, RADIO_EXTRA = 118, ACTUATORS = 93, ACTUATORS_EXTRA = 47 };
enum { IMU = 0x3F, COMPASS = 0x1C0, PRESSURE = 0x1A00, ARMED = 128 };
enum { OUR_SYSTEM = 42, OUR_COMPONENT = 51, FIX_3D = 3, SATELLITES_FIX = 4 };

#define READ(name) (p->sensors.at[SENSOR_##name])

static const double METRES_PER_DEGREE = 6371000.0 * PI / 180.0;
static const double SEA_HPA = 1013.25, SEA_K = 288.15, LAPSE = 0.0065, EXPONENT = 5.255877;

static uint16_t crc_of(const uint8_t *data, int bytes, uint8_t extra)
{
    uint16_t crc = 0xFFFF;
    for (int i = 0; i <= bytes; i++) {
        uint8_t one = (uint8_t)((i < bytes ? data[i] : extra) ^ (crc & 0xFF));
        one ^= (uint8_t)(one << 4);
        crc = (uint16_t)((crc >> 8) ^ (one << 8) ^ (one << 3) ^ (one >> 4));
    }
    return crc;
}

static int framed(const Px4 *p, uint8_t *frame, int number, int bytes, uint8_t extra)
{
    uint8_t *payload = frame + HEADER_2;
    while (bytes > 1 && payload[bytes - 1] == 0)
        bytes--; /* MAVLink 2 leaves zeros at the end out */
    const uint8_t head[HEADER_2] = {STX_2, (uint8_t)bytes, 0, 0, p->sequence, OUR_SYSTEM, OUR_COMPONENT, (uint8_t)number};
    memcpy(frame, head, HEADER_2);
    const uint16_t crc = crc_of(frame + 1, HEADER_2 - 1 + bytes, extra);
    payload[bytes] = (uint8_t)(crc & 0xFF), payload[bytes + 1] = (uint8_t)(crc >> 8);
    return HEADER_2 + bytes + CRC;
}

static uint8_t *put(uint8_t *to, const void *value, size_t bytes)
{
    memcpy(to, value, bytes);
    return to + bytes;
}

static uint8_t *put_float(uint8_t *to, double value)
{
    const float narrow = (float)value;
    return put(to, &narrow, sizeof narrow);
}

static uint8_t *put_whole(uint8_t *to, double value, int bytes)
{
    const int64_t whole = llround(value);
    return put(to, &whole, (size_t)bytes); /* little-endian, as all machines we run on */
}

/* Units m/s2, rad/s, gauss, hPa, m, degrees C; body axes forward, right, down. */
int hil_sensor(const Px4 *p, uint64_t time_us, int pressure_too, int compass_too, uint8_t frame[FRAME_MAX])
{
    const uint32_t updated = IMU | (pressure_too ? PRESSURE : 0u) | (compass_too ? COMPASS : 0u);
    const double height_m = p->home[2] + READ(baro_m), kelvin = SEA_K - LAPSE * height_m;
    uint8_t *to = put(frame + HEADER_2, &time_us, sizeof time_us);
    for (int i = 0; i < 3; i++)
        to = put_float(to, p->sensors.at[SENSOR_acc_x_mps2 + i]);
    for (int i = 0; i < 3; i++)
        to = put_float(to, p->sensors.at[SENSOR_gyro_x_rps + i]);
    for (int i = 0; i < 3; i++)
        to = put_float(to, p->sensors.at[SENSOR_compass_x_gauss + i]);
    to = put_float(to, SEA_HPA * pow(kelvin / SEA_K, EXPONENT));
    to = put_float(to, 0.0); /* no airspeed */
    to = put_float(to, height_m);
    to = put_float(to, kelvin - 273.15);
    to = put(to, &updated, sizeof updated);
    *to = 0; /* the first inertial unit */
    return framed(p, frame, SENSOR, SENSOR_BYTES, SENSOR_EXTRA);
}

/* Position 1e-7 degrees, mm; accuracies and speeds cm and cm/s; no course over ground. */
int hil_gps(const Px4 *p, uint64_t time_us, uint8_t frame[FRAME_MAX])
{
    const double satellites = READ(gps_satellites), vn = READ(gps_vn_mps), ve = READ(gps_ve_mps);
    const int fix = satellites >= SATELLITES_FIX;
    const double spread = satellites >= 9.0 ? 1.0 : 1.0 + 0.35 * (9.0 - satellites); /* as the noise of sensors.c */
    const double east_m = METRES_PER_DEGREE * cos(p->home[0] * PI / 180.0);
    uint8_t *to = put(frame + HEADER_2, &time_us, sizeof time_us);
    to = put_whole(to, 1e7 * (p->home[0] + READ(gps_north_m) / METRES_PER_DEGREE), 4);
    to = put_whole(to, 1e7 * (p->home[1] + READ(gps_east_m) / east_m), 4);
    to = put_whole(to, 1e3 * (p->home[2] + READ(gps_up_m)), 4);
    to = put_whole(to, fix ? 50.0 * spread : 9999.0, 2);
    to = put_whole(to, fix ? 80.0 * spread : 9999.0, 2);
    to = put_whole(to, clamp(100.0 * hypot(vn, ve), 0.0, 65534.0), 2);
    to = put_whole(to, clamp(100.0 * vn, -32767.0, 32767.0), 2);
    to = put_whole(to, clamp(100.0 * ve, -32767.0, 32767.0), 2);
    to = put_whole(to, clamp(100.0 * READ(gps_vd_mps), -32767.0, 32767.0), 2);
    to = put_whole(to, 65535.0, 2);
    to = put_whole(to, fix ? FIX_3D : 0, 1);
    to = put_whole(to, satellites, 1);
    memset(to, 0, 3); /* the first receiver, no heading */
    return framed(p, frame, GPS, GPS_BYTES, GPS_EXTRA);
}

int hil_radio(const Px4 *p, uint64_t time_us, uint8_t frame[FRAME_MAX])
{
    uint8_t *to = put_whole(frame + HEADER_2, (double)(time_us / 1000), 4);
    for (int i = 0; i < 18; i++)
        to = put_whole(to, i < RC_CHANNELS_SENT ? clamp(p->at[P_rc_1 + i], 0.0, 65534.0) : 65535.0, 2);
    to = put_whole(to, RC_CHANNELS_SENT, 1);
    put_whole(to, 100.0, 1);
    return framed(p, frame, RADIO, RADIO_BYTES, RADIO_EXTRA);
}

static void take_actuators(Px4 *p, const uint8_t *payload, int bytes)
{
    uint8_t whole[81] = {0};
    float controls[MOTORS];
    memcpy(whole, payload, (size_t)(bytes < 81 ? bytes : 81));
    memcpy(&p->answered_us, whole, sizeof p->answered_us);
    memcpy(controls, whole + 16, sizeof controls);
    p->armed = (whole[80] & ARMED) != 0;
    p->at[P_armed] = p->armed;
    for (int i = 0; i < MOTORS; i++)
        p->throttles[i] = p->armed && controls[i] > 0.0f ? clamp(controls[i], 0.0, 1.0) : 0.0; /* NaN: stopped */
}

/* Takes whole messages off the front of what came; bytes that begin none are left out. */
int hil_take(Px4 *p, const uint8_t *data, int bytes)
{
    int done = 0;
    while (done < bytes) {
        const uint8_t *at = data + done;
        const int left = bytes - done, second = *at == STX_2;
        if (*at != STX_2 && *at != STX_1) {
            done++;
            continue;
        }
        const int header = second ? HEADER_2 : HEADER_1;
        if (left < header)
            break;
        const int size = header + at[1] + CRC + (second && (at[2] & SIGNED) ? SIGNATURE : 0);
        if (left < size)
            break;
        const int number = second ? at[7] | at[8] << 8 | at[9] << 16 : at[5];
        const uint16_t crc = (uint16_t)(at[header + at[1]] | at[header + at[1] + 1] << 8);
        if (number == ACTUATORS && crc == crc_of(at + 1, header - 1 + at[1], ACTUATORS_EXTRA))
            take_actuators(p, at + header, at[1]);
        done += size;
    }
    return done;
}
