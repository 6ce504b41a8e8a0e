/* The paper's single-track model driven by torques, one simulation after another in scalar C.

   The same equations, integrator and loop between loads and forces as vehicle_sbi.physics, without optional effects. */

#include <math.h>

#define GRAVITY 9.81
#define STEEPEST 1.5
#define TOLERANCE 1e-9
#define SECANTS 30
#define ITERATIONS 100

enum { V_X, V_Y, R, OMEGA_F, OMEGA_R, KAPPA_F, KAPPA_R, ALPHA_F, ALPHA_R, STATES };

typedef struct { /* constants of a vehicle, in the order in which they are handed over */
    double m, L, l_f, h_cog, C_kappa_f, C_kappa_r, C_alpha_f, C_alpha_r, mu, R_f, C_vert, I_wf, I_wr, K;
} Vehicle;

typedef struct { double a_x, F_xf, F_yf, F_along, F_lateral, F_xr, F_yr; int final; } Forces;

static double regular(double v) { v = fabs(v); return v >= 1.0 ? v : 0.5 * (1.0 + v * v); }

static double slip(double rolling, double v) { return fmax((rolling - v) / regular(fmax(rolling, v)), -1.0); }

static double wheel_torque(double torque, double omega) {
    if (torque >= 0.0 || omega >= 1.0) return torque;
    return omega <= -1.0 ? -torque : torque * omega * (2.0 - fabs(omega));
}

static double tangent(double alpha) { return tan(fmin(fmax(alpha, -STEEPEST), STEEPEST)); }

static double radius(const Vehicle *p, double F_z) { return p->R_f - 0.5 * F_z / (3.0 * p->C_vert); }

static void dugoff(double C_kappa, double C_alpha, double mu, double F_z, double kappa, double tan_alpha,
                   double *F_x, double *F_y) {
    double x = C_kappa * kappa, y = C_alpha * tan_alpha, grip = mu * fmax(F_z, 0.0), demand = sqrt(x * x + y * y);
    double factor = 0.0;
    if (demand > 0.0)
        factor = grip * (1.0 + kappa) >= 2.0 * demand
                     ? 1.0 / (1.0 + kappa)
                     : 0.5 * grip / demand * (2.0 - 0.5 * grip * (1.0 + kappa) / demand);
    *F_x = x * factor;
    *F_y = y * factor;
}

static int grips(double mu, double F_z, double F_x, double F_y) {
    double half = 0.5 * mu * fmax(F_z, 0.0);
    return F_x * F_x + F_y * F_y < half * half;
}

static Forces forces(const Vehicle *p, const double *x, double c, double s, double tan_f, double tan_r, double a_x) {
    Forces f;
    double l_r = p->L - p->l_f, weight = p->m * GRAVITY, lever = p->m * p->h_cog / p->L;
    double F_zf = weight * l_r / p->L - lever * a_x, F_zr = weight * p->l_f / p->L + lever * a_x;
    dugoff(p->C_kappa_f, p->C_alpha_f, p->mu, F_zf, x[KAPPA_F], tan_f, &f.F_xf, &f.F_yf);
    dugoff(p->C_kappa_r, p->C_alpha_r, p->mu, F_zr, x[KAPPA_R], tan_r, &f.F_xr, &f.F_yr);
    f.F_along = f.F_xf * c - f.F_yf * s + f.F_xr;
    f.F_lateral = f.F_xf * s + f.F_yf * c;
    f.a_x = f.F_along / p->m;
    double moved = fabs(lever * (f.a_x - a_x));
    f.final = grips(p->mu, F_zf - moved, f.F_xf, f.F_yf) && grips(p->mu, F_zr - moved, f.F_xr, f.F_yr);
    return f;
}

/* rate[V_X] on entry is where the loop between load transfer and longitudinal force starts. */
static void derivatives(const Vehicle *p, const double *u, const double *x, double *rate) {
    double delta = u[0], speed = regular(x[V_X]), l_r = p->L - p->l_f, v_yf = x[V_Y] + p->l_f * x[R];
    double beta = atan(v_yf / speed), alpha_r = -atan((x[V_Y] - l_r * x[R]) / speed);
    double c = cos(delta), s = sin(delta), tan_f = tangent(x[ALPHA_F]), tan_r = tangent(x[ALPHA_R]);
    double a_x = rate[V_X] - x[V_Y] * x[R], before = 0.0, led = 0.0;
    Forces f;
    for (int i = 0;; i++) {
        f = forces(p, x, c, s, tan_f, tan_r, a_x);
        double off = f.a_x - a_x;
        if (f.final) { a_x = f.a_x; break; }
        if (fabs(off) < TOLERANCE) break;
        if (i == ITERATIONS) { a_x = NAN; break; }
        double back = 0.0, size = (off - before) * (off - before);
        if (i > 0 && i < SECANTS && size > 0.0) back = fmin(fmax((off - before) * off / size, -9.0), 0.9);
        double part = i < SECANTS ? 1.0 : 0.5, next = a_x + part * off - back * (a_x + off - led);
        led = a_x + off;
        before = off;
        a_x = next;
    }
    double lever = p->m * p->h_cog / p->L * a_x, weight = p->m * GRAVITY;
    double R_f = radius(p, weight * l_r / p->L - lever), R_r = radius(p, weight * p->l_f / p->L + lever);
    double kappa_f = slip(R_f * x[OMEGA_F], x[V_X] * c + v_yf * s), kappa_r = slip(R_r * x[OMEGA_R], x[V_X]);
    rate[V_X] = a_x + x[V_Y] * x[R];
    rate[V_Y] = (f.F_lateral + f.F_yr) / p->m - x[V_X] * x[R];
    rate[R] = (p->l_f * f.F_lateral - l_r * f.F_yr) / (p->m * p->l_f * l_r);
    rate[OMEGA_F] = (wheel_torque(u[1], x[OMEGA_F]) - f.F_xf * R_f) / p->I_wf;
    rate[OMEGA_R] = (wheel_torque(u[2], x[OMEGA_R]) - f.F_xr * R_r) / p->I_wr;
    double fade_f = speed * p->K / p->C_alpha_f, fade_r = speed * p->K / p->C_alpha_r;
    rate[KAPPA_F] = fade_f * (kappa_f - x[KAPPA_F]);
    rate[KAPPA_R] = fade_r * (kappa_r - x[KAPPA_R]);
    rate[ALPHA_F] = fade_f * (delta - beta - x[ALPHA_F]);
    rate[ALPHA_R] = fade_r * (alpha_r - x[ALPHA_R]);
}

static void start(const Vehicle *p, double delta, double v_0, double *x) {
    double l_r = p->L - p->l_f, weight = p->m * GRAVITY;
    for (int i = 0; i < STATES; i++) x[i] = 0.0;
    x[V_X] = v_0;
    x[OMEGA_F] = v_0 * cos(delta) / radius(p, weight * l_r / p->L);
    x[OMEGA_R] = v_0 / radius(p, weight * p->l_f / p->L);
    x[ALPHA_F] = delta;
}

/* y (n, 5, time): a_x, a_y, yaw rate, front and rear wheel speed; u (time, 3): steering, front and rear torque. */
void simulate(int n, const Vehicle *vehicles, const double *v_0, int time, const double *u, double dt, int substeps,
              double *y) {
    double h = dt / substeps;
    for (int i = 0; i < n; i++) {
        const Vehicle *p = vehicles + i;
        double x[STATES], trial[STATES], rate[STATES] = {0}, total[STATES], now[3];
        start(p, u[0], v_0[i], x);
        for (int e = 0; e <= 4 * substeps * (time - 1); e++) {
            int step = e / 4, stage = e % 4, k = step / substeps, next = k + 1 < time ? k + 1 : k;
            double share = 0.5 * ((stage + 1) / 2), at = (step % substeps + share) / substeps;
            for (int j = 0; j < 3; j++) now[j] = u[3 * k + j] + at * (u[3 * next + j] - u[3 * k + j]);
            for (int j = 0; j < STATES; j++) trial[j] = x[j] + share * h * rate[j];
            derivatives(p, now, trial, rate);
            if (e % (4 * substeps) == 0) {
                double *row = y + (long)i * 5 * time + k;
                row[0] = rate[V_X] - trial[V_Y] * trial[R];
                row[time] = rate[V_Y] + trial[V_X] * trial[R];
                row[2 * time] = trial[R];
                row[3 * time] = trial[OMEGA_F];
                row[4 * time] = trial[OMEGA_R];
            }
            double weight = stage % 3 == 0 ? h / 6.0 : h / 3.0;
            for (int j = 0; j < STATES; j++) {
                total[j] = weight * rate[j] + (stage == 0 ? trial[j] : total[j]);
                if (stage == 3) x[j] = total[j];
            }
        }
    }
}
