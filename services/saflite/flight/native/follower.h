/* How PX4 1.12 flies to the planner's set-point: its auto task with jerk-limited trajectories (line-smooth velocity).
 *
 * Two of its habits shape every avoidance flight and are kept on purpose:
 *  - the internal target. Off the line between way-points by more than the acceptance radius, the task aims at the point
 *    of the line where the vehicle left it; that point is not moved along while the vehicle flies on.
 *  - the turning lock. While the trajectory moves faster than 0.2 m/s and more than 11.5 deg off the direction to the
 *    internal target, the speed may not exceed the one before the turn. A vehicle that nearly stopped to turn and then
 *    leaves the line is thereby held at 0.2-0.4 m/s until it is back on the line or the next leg begins. Real flights
 *    show exactly this: constant creeping for minutes, ended at the way-point or half a metre off the line. */
#ifndef SAFLITE_FOLLOWER_H
#define SAFLITE_FOLLOWER_H

enum { FOLLOWER_ON_LINE, FOLLOWER_TARGET_BEHIND, FOLLOWER_BEFORE_LINE, FOLLOWER_OFF_TRACK };

typedef struct {
    double position[3], velocity[3], acceleration[3];    /* trajectory set-points handed to the position controller */
    double target[2];                                    /* internal target in the plane */
    double speed_before_turn;
    int line_state, turning;
} Follower;

typedef struct {
    double acceleration, jerk, cruise, up, down, accept, error_max, lock;    /* SI units; lock 0 switches the habit off */
} FollowerLimits;

/* Puts the trajectory at the vehicle. */
void follower_start(Follower *f, const double at[3], const double velocity[3]);

/* A new leg from -> goal begins. */
void follower_leg(Follower *f, const double from[3], const double goal[3], const double at[3], double accept_m);

/* One step of dt seconds towards `setpoint`, the vehicle being estimated at `at`. */
void follower_step(Follower *f, const FollowerLimits *limits, const double from[3], const double goal[3], const double at[3],
                   const double setpoint[3], double dt);

/* Greatest speed from which a vehicle stops within `distance` (PX4's braking model), m/s. */
double follower_speed(double jerk, double acceleration, double distance);

#endif
