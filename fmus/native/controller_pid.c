/* One PID per joint. */
#include <math.h>
#include <string.h>

#include "controller_parts.h"

void pid_reset(controller_pid_state *pid)
{
    memset(pid, 0, sizeof *pid);
    for (int i = 0; i < JOINTS; i++) pid->error_before[i] = NAN; /* marks the first update */
}

void pid_update(controller_pid_state *pid, const controller_gains *gains, double period,
                const double error[JOINTS], double correction[JOINTS])
{
    const double time = gains->derivative_filter + period, decay = gains->derivative_filter / time;
    if (isnan(pid->error_before[0])) memcpy(pid->error_before, error, sizeof pid->error_before);
    for (int i = 0; i < JOINTS; i++) {
        const double limit = gains->integral_limit[i], change = error[i] - pid->error_before[i];
        pid->integral[i] = clamp(pid->integral[i] + gains->ki[i] * period * error[i], -limit, limit);
        pid->derivative[i] = decay * pid->derivative[i] + gains->kd[i] / time * change;
        pid->error_before[i] = error[i];
        correction[i] = gains->kp[i] * error[i] + pid->integral[i] + pid->derivative[i];
    }
}
