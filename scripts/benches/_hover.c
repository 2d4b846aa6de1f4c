/* The world and the sensors in one native loop through their seams, with no autopilot. */
#include "sensors.h"
#include "world.h"

int hover(World *w, Sensors *s, double throttle, int steps)
{
    const double throttles[MOTORS] = {throttle, throttle, throttle, throttle};
    for (int i = 0; i < steps; i++) {
        if (world_step(w, throttles))
            return -1;
        sensors_read(s, w->at);
    }
    return 0;
}
