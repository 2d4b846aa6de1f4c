/* Drives JSBSim from C: a call per physics step, sensors and control in between, without a line of Python per step.
 *
 * JSBSim's Python objects are reached through CPython's stable interface (declared here, so no Python headers are
 * needed to build); the library is loaded with ctypes.PyDLL, so the interpreter lock is held throughout.
 */
#include <stddef.h>
#include <string.h>

#include "vehicle.h"

#define AT(name) (v->at[S_##name])

typedef struct PyObject PyObject;
extern PyObject *PyObject_CallFunctionObjArgs(PyObject *callable, ...);
extern PyObject *PyFloat_FromDouble(double value);
extern double PyFloat_AsDouble(PyObject *object);
extern PyObject *PyErr_Occurred(void);
extern void Py_DecRef(PyObject *object);

enum { NODES_IMU = 6, NODES_STATE = 9, NODES_MOTOR = 4 };
static const double FOOT_M = 0.3048;

static const char *const NAMES[] = {
#define SLOT_NAME(name) #name,
    SLOTS(SLOT_NAME)
#undef SLOT_NAME
};

int vehicle_slot_count(void) { return SLOT_COUNT; }
const char *vehicle_slot_name(int slot) { return slot >= 0 && slot < SLOT_COUNT ? NAMES[slot] : NULL; }
size_t vehicle_size(void) { return sizeof(Vehicle); }

void vehicle_start(Vehicle *v, const uint64_t rng_seeds[4], const double *boxes, int box_count)
{
    memset(v, 0, sizeof *v);
    v->rng_imu = rng_seeds[0], v->rng_baro = rng_seeds[1], v->rng_gps = rng_seeds[2], v->rng_mag = rng_seeds[3];
    v->boxes = boxes;
    v->box_count = box_count;
}

void vehicle_record(Vehicle *v, float *rows, const int32_t *columns, int column_count, int row_limit, int steps_per_row)
{
    v->rows = rows, v->columns = columns, v->column_count = column_count;
    v->row_limit = row_limit, v->steps_per_row = steps_per_row, v->row_count = 0;
}

int vehicle_rows(const Vehicle *v) { return v->row_count; }

/* Write one row of the trace; the shell calls it for the first and the last, `vehicle_run` in between. */
void vehicle_row(Vehicle *v)
{
    if (v->rows == NULL || v->row_count >= v->row_limit)
        return;
    float *row = v->rows + (size_t)v->row_count * (size_t)v->column_count;
    for (int i = 0; i < v->column_count; i++)
        row[i] = (float)v->at[v->columns[i]];
    v->row_count++;
}

void vehicle_sense(Vehicle *v)
{
    world_state(v);
    sensors_imu(v);
    sensors_slow(v);
}

/* Take the truth as believed: the start of a flight, or a start state in the air. */
void vehicle_align(Vehicle *v)
{
    sensors_start(v);
    vehicle_sense(v);
    estimator_start(v);
    control_start(v);
}

static int call(PyObject *function)
{
    PyObject *answer = PyObject_CallFunctionObjArgs(function, NULL);
    if (answer == NULL)
        return -1;
    Py_DecRef(answer);
    return 0;
}

static int get(PyObject *getter, double scale, double *into)
{
    PyObject *answer = PyObject_CallFunctionObjArgs(getter, NULL);
    if (answer == NULL)
        return -1;
    *into = scale * PyFloat_AsDouble(answer);
    Py_DecRef(answer);
    return 0;
}

static int put(PyObject *setter, double value)
{
    PyObject *number = PyFloat_FromDouble(value);
    PyObject *answer = number == NULL ? NULL : PyObject_CallFunctionObjArgs(setter, number, NULL);
    if (number != NULL)
        Py_DecRef(number);
    if (answer == NULL)
        return -1;
    Py_DecRef(answer);
    return 0;
}

int vehicle_read_imu(Vehicle *v, PyObject *const *nodes)
{
    int bad = 0;
    for (int i = 0; i < NODES_IMU; i++)
        bad |= get(nodes[i], i < 3 ? 1.0 : FOOT_M, &v->at[S_p_rps + i]);
    return bad;
}

/* `origin_m` is JSBSim's height reading at the take-off point. */
int vehicle_read_state(Vehicle *v, PyObject *const *nodes, double origin_m)
{
    int bad = 0;
    for (int i = 0; i < NODES_STATE; i++)
        bad |= get(nodes[i], i < 6 ? FOOT_M : 1.0, &v->at[S_north_m + i]);
    AT(up_m) -= origin_m;
    if (AT(psi) > PI)
        AT(psi) -= 2.0 * PI;
    return bad;
}

/* Standing on the ground with motors off nothing moves: only the sensors tick, JSBSim need not. */
static void stand_still(Vehicle *v)
{
    AT(p_rps) = AT(q_rps) = AT(r_rps) = AT(force_x) = AT(force_y) = 0.0;
    AT(force_z) = -GRAVITY;
    AT(v_north) = AT(v_east) = AT(v_down) = 0.0;
}

/* Run `steps` physics steps. `run` steps JSBSim; `nodes` are getters (6 inertial, 9 state), then 4 motor setters.
 * Returns 0, or -1 with a Python error set. Stops stepping the physics once the world froze. */
int vehicle_run(Vehicle *v, int steps, PyObject *run, PyObject *const *nodes, double origin_m)
{
    PyObject *const *state = nodes + NODES_IMU, *const *motors = state + NODES_STATE;
    for (int i = 0; i < steps; i++) {
        const int moving = AT(world_state) == WORLD_FLYING;
        v->step++;
        if (moving && (call(run) || vehicle_read_imu(v, nodes)))
            return -1;
        if (!moving)
            stand_still(v);
        sensors_imu(v);
        estimator_step(v);
        if (v->step % STEPS_PER_STATE == 0) {
            if (moving && vehicle_read_state(v, state, origin_m))
                return -1;
            world_state(v);
            sensors_slow(v);
            estimator_slow(v);
            world_contact(v);
        }
        control_step(v);
        if (moving)
            for (int m = 0; m < NODES_MOTOR; m++)
                if (put(motors[m], v->at[S_motor_1 + m]))
                    return -1;
        if (v->steps_per_row > 0 && v->step % v->steps_per_row == 0)
            vehicle_row(v);
    }
    return PyErr_Occurred() == NULL ? 0 : -1;
}
