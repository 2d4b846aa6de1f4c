/* The one native loop of a flight: world, sensors, estimator, control, trace, without a line of Python per step. */
#include "vehicle.h"

#include <math.h>
#include <string.h>

static const double OFFSET_CREEP_MPS = 0.3; /* a changed offset creeps in, as in AP_Baro */
static const double SATELLITES_FIX = 4.0;

static const char *const NAMES[] = {
#define SLOT_NAME(name) #name,
    SLOTS(SLOT_NAME)
#undef SLOT_NAME
};

const char *vehicle_slot_name(int slot) { return slot >= 0 && slot < SLOT_COUNT ? NAMES[slot] : NULL; }
size_t vehicle_size(void) { return sizeof(Vehicle); }
size_t vehicle_offset(int part) /* of the world 0, the sensors 1, the blackboard 2 */
{
    return part == 0 ? offsetof(Vehicle, world) : part == 1 ? offsetof(Vehicle, sensors) : offsetof(Vehicle, at);
}

void vehicle_record(Vehicle *v, float *rows, const int32_t *columns, int column_count, int row_limit, int steps_per_row)
{
    v->recorder = (Recorder){rows, columns, column_count, row_limit, 0, steps_per_row};
    recorder_row(&v->recorder, (const double *)v);
}

int vehicle_rows(const Vehicle *v) { return v->recorder.row_count; }

static void measure_home(Vehicle *v)
{
    const double n = TRUTH(x_m) - AT(home_north), e = TRUTH(y_m) - AT(home_east);
    AT(home_distance_m) = sqrt(n * n + e * e);
}

/* From raw readings to heights above home and a monitored battery, as the parameters say. */
static void receive(Vehicle *v)
{
    const double creep = OFFSET_CREEP_MPS * (STEPS_PER_STATE * STEP_S);
    v->baro_offset += clamp(AT(baro_alt_offset) - v->baro_offset, -creep, creep);
    AT(baro_ok) = READING(baro_alive);
    if (AT(baro_ok) != 0.0)
        AT(baro_altitude_m) = (READING(baro_m) - AT(baro_ground_m)) * AT(baro_gain) + v->baro_offset;
    AT(battery_a) = READING(pack_a) * AT(battery_amp_scale);
    AT(battery_v) = READING(pack_v) * AT(battery_volt_scale);
    if (step_of(v) % STEPS_PER_GPS != 0)
        return;
    AT(gps_ok) = READING(gps_satellites) >= AT(gps_sats_min) ? 1.0 : 0.0;
    if (READING(gps_satellites) >= SATELLITES_FIX)
        AT(gps_altitude_m) = READING(gps_up_m) - AT(home_up);
}

/* Take the truth as believed: the start of a flight, or a start state in the air. */
void vehicle_align(Vehicle *v)
{
    measure_home(v);
    sensors_read(&v->sensors, v->world.at);
    receive(v);
    estimator_start(v);
    control_start(v);
}

/* Run `steps` physics steps; 0, or -1 with a Python error set. */
int vehicle_run(Vehicle *v, int steps)
{
    for (int i = 0; i < steps; i++) {
        if (world_advance(&v->world))
            return -1;
        sensors_read(&v->sensors, v->world.at);
        estimator_step(v);
        if (step_of(v) % STEPS_PER_STATE == 0) {
            measure_home(v);
            receive(v);
            estimator_slow(v);
        }
        control_step(v);
        if (world_actuate(&v->world, v->motor))
            return -1;
        recorder_step(&v->recorder, (const double *)v, step_of(v));
    }
    return 0;
}
