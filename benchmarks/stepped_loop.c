/* The plain loop that `stepped` is compared with: the same soft adhesive contact and the same velocity
 * Verlet scheme, whose velocity at the end of a step is implicit (two unknowns). The sign of the gap at
 * the end of each step distinguishes contact from flight.
 * Units: phase in rad, lengths in plate amplitudes, forces in m A omega^2. */

#include <math.h>
#include <stdint.h>

/* (1 + h/2 C)^-1 for C = ((beta, -b), (-beta, 2 b)). */
struct inverse { double i, j, k, n; };

static struct inverse inverse(double beta, double b, double half)
{
    const double det = 1.0 + half * (beta + 2.0 * b) + half * half * beta * b;
    struct inverse m = {(1.0 + 2.0 * half * b) / det, half * b / det, half * beta / det, (1.0 + half * beta) / det};
    return m;
}

/* Runs `periods` plate periods of `steps` steps from rest. Writes the longest flight of the last
 * half (rad, interpolated between steps) to *longest and the number of all flights to *flights;
 * returns the elongation at the end. */
double stepped_loop(double gamma, double omega, double xi, double zeta, double d, int64_t steps,
                    int64_t periods, double *longest, int64_t *flights)
{
    const double tau = 6.283185307179586, h = tau / (double)steps, half = 0.5 * h, per_half = 1.0 / half;
    const double w = 1.0 / (omega * omega), b = 2.0 * xi / omega, g = 1.0 / gamma;
    const double kappa = 1.0 / (d * d), beta = 2.0 * zeta / d;
    const double turn_cos = cos(h), turn_sin = sin(h);
    const struct inverse in = inverse(beta, b, half), off = inverse(0.0, b, half);
    double gap = -2.0 / (gamma * kappa), gap1 = 0.0, q = -1.0 / (gamma * w), q1 = 0.0, takeoff = 0.0;
    *longest = 0.0;
    *flights = 0;
    for (int64_t period = 0; period < periods; period++) {
        double c = 1.0, s = 0.0;
        double press = gap < 0.0 ? kappa * gap + beta * gap1 : 0.0, pull = w * q + b * q1;
        double a = c - g + pull - press, a1 = press - 2.0 * pull;
        for (int64_t i = 0; i < steps; i++) {
            const double before = gap, v = gap1 + half * a, u = q1 + half * a1;
            const double turned = c * turn_cos - s * turn_sin;
            s = s * turn_cos + c * turn_sin;
            c = turned;
            gap += h * v;
            q += h * u;
            if (gap < 0.0) {
                const double r = v + half * (c - g + w * q - kappa * gap);
                const double r1 = u + half * (kappa * gap - 2.0 * w * q);
                gap1 = in.i * r + in.j * r1;
                q1 = in.k * r + in.n * r1;
                if (before > 0.0) {
                    const double now = tau * (double)period + h * ((double)i + before / (before - gap));
                    if (2 * period >= periods && now - takeoff > *longest)
                        *longest = now - takeoff;
                    *flights += 1;
                }
            } else {
                const double r = v + half * (c - g + w * q), r1 = u - half * 2.0 * w * q;
                gap1 = off.i * r + off.j * r1;
                q1 = off.n * r1;
                if (before < 0.0)
                    takeoff = tau * (double)period + h * ((double)i + before / (before - gap));
            }
            a = (gap1 - v) * per_half;
            a1 = (q1 - u) * per_half;
        }
    }
    return q;
}
