/* JSBSim stepped, read and driven from C, without a line of Python per step.
 *
 * Its Python objects are reached through CPython's stable interface (declared here, so no Python headers are needed to
 * build); the library is loaded with ctypes.PyDLL, so the interpreter lock is held throughout.
 */
#include <stddef.h>

#include "world.h"

extern PyObject *PyObject_CallFunctionObjArgs(PyObject *callable, ...);
extern PyObject *PyFloat_FromDouble(double value);
extern double PyFloat_AsDouble(PyObject *object);
extern void Py_DecRef(PyObject *object);

enum { NODES_RATES = 6, NODES_STATE = 9, STATE_CLIMB = 5, STATE_ANGLES = 6 };
static const double FOOT_M = 0.3048;

int jsbsim_run(World *w)
{
    PyObject *answer = PyObject_CallFunctionObjArgs(w->run, NULL);
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

int jsbsim_read_rates(World *w)
{
    int bad = 0;
    for (int i = 0; i < NODES_RATES; i++)
        bad |= get(w->nodes[i], i < 3 ? 1.0 : FOOT_M, &w->at[WORLD_roll_rate_rps + i]);
    return bad;
}

int jsbsim_read_state(World *w)
{
    PyObject *const *nodes = w->nodes + NODES_RATES;
    int bad = 0;
    for (int i = 0; i < NODES_STATE; i++) {
        const double scale = i == STATE_CLIMB ? -FOOT_M : FOOT_M;
        bad |= get(nodes[i], i < STATE_ANGLES ? scale : 1.0, &w->at[WORLD_x_m + i]);
    }
    w->at[WORLD_altitude_m] -= w->origin_m;
    if (w->at[WORLD_yaw_rad] > PI)
        w->at[WORLD_yaw_rad] -= 2.0 * PI;
    return bad;
}

int jsbsim_write_motors(World *w)
{
    PyObject *const *nodes = w->nodes + NODES_RATES + NODES_STATE;
    int bad = 0;
    for (int i = 0; i < MOTORS; i++)
        bad |= put(nodes[i], w->at[WORLD_motor_1 + i]);
    return bad;
}
