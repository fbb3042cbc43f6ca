/* The batch's closed loop by hand: ARC or OARC, valve with friction, LVDT, indices; one valve after the other.
 *
 * Structs have the fields of the NamedTuples in their order, all doubles. Noise comes from numpy's own C
 * library (libnpyrandom) with the generators of numpy, so that results can be compared. The guaranteed bound
 * on V2, which moves nothing, is left out.
 */
#include <math.h>
#include <stdint.h>
#include <string.h>

typedef struct bitgen bitgen;
void random_standard_normal_fill(bitgen *, intptr_t, double *);

typedef struct { double a1, a0, b0, b0dn; } theta_t;
typedef struct { double natural_frequency, damping, max_rate, max_accel, period; } reshaping_t;
typedef struct { double decay, gain; } guarantee_t;

typedef struct {
    double k1, k2;
    theta_t gamma, theta_initial, theta_min, theta_max;
    double robust, epsilon, disturbance_bound, u_max, period;
    reshaping_t reshaping;
    struct { double period, smoothing; } velocity;
    guarantee_t guarantee;
} arc_t;

typedef struct {
    double k1, k2, ks1, ks2, z2_weight;
    theta_t gamma, theta_initial, theta_min, theta_max;
    double robust, epsilon1, epsilon2, disturbance_bound, u_max, period;
    struct { double a11, a12, a21, a22, b1, b2; } filter;
    reshaping_t reshaping;
    guarantee_t guarantee;
} oarc_t;

typedef struct {
    double row0[4], row1[4], row2[4], row3[4], input[4];
    double gain_scale, u_max, period;
    struct {
        double coulomb, static_ratio, stribeck_velocity, velocity_scale, presliding;
        double flow_force, offset, stiffness_drift, gain_drift;
    } disturbance;
    struct { double noise, resolution, bias, delay; } lvdt;
} valve_t;

typedef struct { double x[4], bristle, time; } spool_t;
typedef struct { double reference, rate; } reference_t;
typedef struct { reference_t reference; double measurement, velocity; theta_t theta; } arc_state;
typedef struct { double first, second; } pair_t;
typedef struct { reference_t reference; pair_t eta, v0, psi; theta_t theta; } oarc_state;

static inline double limited(double value, double lower, double upper)
{
    return value > upper ? upper : value < lower ? lower : value;
}

static inline double acceleration(const reshaping_t *p, reference_t s, double command)
{
    double wn = p->natural_frequency;
    double accel = -2.0 * p->damping * wn * s.rate - wn * wn * (s.reference - command);
    accel = limited(accel, -p->max_accel, p->max_accel);
    double rate = s.rate + accel * p->period;
    if (rate > p->max_rate)
        accel = (p->max_rate - s.rate) / p->period;
    else if (rate < -p->max_rate)
        accel = (-p->max_rate - s.rate) / p->period;
    return accel;
}

static inline reference_t next_reference(const reshaping_t *p, reference_t s, double accel)
{
    reference_t next = {s.reference + s.rate * p->period, s.rate + accel * p->period};
    return next;
}

static inline double rate_of(double estimate, double rate, double lower, double upper)
{
    if ((estimate >= upper && rate > 0.0) || (estimate <= lower && rate < 0.0))
        return 0.0;
    return rate;
}

#define RATE(f) rate_of(t->f, gamma->f * tau.f, lower->f, upper->f)
static inline theta_t rates(const theta_t *t, const theta_t *gamma, theta_t tau, const theta_t *lower,
                            const theta_t *upper)
{
    theta_t made = {RATE(a1), RATE(a0), RATE(b0), RATE(b0dn)};
    return made;
}

#define ADVANCE(f) limited(t->f + rate.f * period, lower->f, upper->f)
static inline theta_t advance(const theta_t *t, theta_t rate, double period, const theta_t *lower,
                              const theta_t *upper)
{
    theta_t made = {ADVANCE(a1), ADVANCE(a0), ADVANCE(b0), ADVANCE(b0dn)};
    return made;
}

static inline double uncertainty(theta_t span, theta_t phi, double bound)
{
    return span.a1 * fabs(phi.a1) + span.a0 * fabs(phi.a0) + span.b0 * fabs(phi.b0) +
           span.b0dn * fabs(phi.b0dn) + bound;
}

static inline theta_t span_of(const theta_t *lower, const theta_t *upper)
{
    theta_t made = {upper->a1 - lower->a1, upper->a0 - lower->a0, upper->b0 - lower->b0,
                    upper->b0dn - lower->b0dn};
    return made;
}

static inline void arc_begin(const arc_t *p, arc_state *s, double first)
{
    arc_state made = {{first, 0.0}, first, 0.0, p->theta_initial};
    *s = made;
}

static inline double arc_step(const arc_t *p, arc_state *s, double command, double x1)
{
    double accel = acceleration(&p->reshaping, s->reference, command);
    double difference = (x1 - s->measurement) / p->velocity.period;
    double x2 = s->velocity + p->velocity.smoothing * (difference - s->velocity);
    double rate = s->reference.rate;
    double z1 = x1 - s->reference.reference;
    double z2 = x2 - (rate - p->k1 * z1);
    double x2eq_dot = accel - p->k1 * (x2 - rate);
    theta_t t = s->theta;
    double u_a = (t.a1 * x2 + t.a0 * x1 - t.b0dn + x2eq_dot - z1) / t.b0;
    double u_s1 = -p->k2 * z2 / p->theta_min.b0;
    theta_t phi = {-x2, -x1, u_a, 1.0};
    double u_s2 = 0.0;
    if (p->robust > 0.0) {
        double h = uncertainty(span_of(&p->theta_min, &p->theta_max), phi, p->disturbance_bound);
        u_s2 = -h * h * z2 / (4.0 * p->epsilon * p->theta_min.b0);
    }
    double wanted = u_a + u_s1 + u_s2;
    double voltage = limited(wanted, -p->u_max, p->u_max);
    if (voltage == wanted) {
        theta_t tau = {phi.a1 * z2, phi.a0 * z2, phi.b0 * z2, phi.b0dn * z2};
        s->theta = advance(&t, rates(&t, &p->gamma, tau, &p->theta_min, &p->theta_max), p->period,
                           &p->theta_min, &p->theta_max);
    }
    s->reference = next_reference(&p->reshaping, s->reference, accel);
    s->measurement = x1;
    s->velocity = x2;
    return voltage;
}

static inline void oarc_begin(const oarc_t *p, oarc_state *s, double first)
{
    double k1 = p->k1, k2 = p->k2;
    oarc_state made = {{first, 0.0}, {first / k2, k1 * first / k2}, {0.0, 0.0}, {1.0 / k2, k1 / k2},
                       p->theta_initial};
    *s = made;
}

static inline pair_t filtered(const oarc_t *p, pair_t x, double value)
{
    pair_t next = {p->filter.a11 * x.first + p->filter.a12 * x.second + p->filter.b1 * value,
                   p->filter.a21 * x.first + p->filter.a22 * x.second + p->filter.b2 * value};
    return next;
}

static inline double oarc_step(const oarc_t *p, oarc_state *s, double command, double x1)
{
    double accel = acceleration(&p->reshaping, s->reference, command);
    double k1 = p->k1, k2 = p->k2, rho = p->z2_weight, b0_min = p->theta_min.b0;
    theta_t t = s->theta;
    double inverse_b0 = 1.0 / t.b0, stiffness = p->ks1 / b0_min, rate = s->reference.rate;
    theta_t span = span_of(&p->theta_min, &p->theta_max);
    pair_t eta = s->eta, v0 = s->v0, psi = s->psi;

    double xi22 = -k1 * k2 * eta.first + k2 * eta.second, xi12 = -k2 * eta.first, xi02 = eta.second;
    double v02 = v0.second, psi2 = psi.second;
    double xi22_dot = -k1 * k2 * (-k1 * eta.first + eta.second) + k2 * (-k2 * eta.first + x1);
    double xi12_dot = -k2 * (-k1 * eta.first + eta.second), xi02_dot = -k2 * eta.first + x1;
    double psi2_dot = -k2 * psi.first + 1.0;

    double z1 = x1 - s->reference.reference;
    double alpha_a = (-xi22 + t.a1 * (xi12 + x1) + t.a0 * xi02 - t.b0dn * psi2 + rate) * inverse_b0;
    theta_t phi1 = {-(xi12 + x1), -xi02, alpha_a, psi2};
    double w1 = span.a1 * span.a1, w2 = span.a0 * span.a0, w3 = span.b0 * span.b0, w4 = span.b0dn * span.b0dn;
    double scale = p->robust > 0.0 ? 5.0 / (4.0 * p->epsilon1 * b0_min) : 0.0;
    double gain = scale * (w1 * phi1.a1 * phi1.a1 + w2 * phi1.a0 * phi1.a0 + w3 * phi1.b0 * phi1.b0 +
                           w4 * phi1.b0dn * phi1.b0dn + p->disturbance_bound * p->disturbance_bound);
    double z2 = v02 - (alpha_a + -stiffness * z1 + -gain * z1);
    double gain_slope = 2.0 * scale * (w3 * phi1.b0 * t.a1 * inverse_b0 - w1 * phi1.a1);
    double slope = t.a1 * inverse_b0 - stiffness - gain - gain_slope * z1;
    theta_t phi2 = {slope * (xi12 + x1), slope * xi02, z1 / rho - slope * v02, -slope * psi2};
    theta_t tau = {phi1.a1 * z1 + rho * phi2.a1 * z2, phi1.a0 * z1 + rho * phi2.a0 * z2,
                   phi1.b0 * z1 + rho * phi2.b0 * z2, phi1.b0dn * z1 + rho * phi2.b0dn * z2};
    theta_t tr = rates(&t, &p->gamma, tau, &p->theta_min, &p->theta_max);

    double x1_dot = xi22 - t.a1 * (xi12 + x1) - t.a0 * xi02 + t.b0 * v02 + t.b0dn * psi2;
    double alpha_a_dot = (-xi22_dot + tr.a1 * (xi12 + x1) + t.a1 * (xi12_dot + x1_dot) + tr.a0 * xi02 +
                          t.a0 * xi02_dot - tr.b0dn * psi2 - t.b0dn * psi2_dot + accel - tr.b0 * alpha_a) *
                         inverse_b0;
    double gain_dot = 2.0 * scale * (w1 * phi1.a1 * -(xi12_dot + x1_dot) + w2 * phi1.a0 * -xi02_dot +
                                     w3 * phi1.b0 * alpha_a_dot + w4 * phi1.b0dn * psi2_dot);
    double alpha_dot = alpha_a_dot - (stiffness + gain) * (x1_dot - rate) - gain_dot * z1;
    double u_s2 = 0.0;
    if (p->robust > 0.0) {
        double h2 = uncertainty(span, phi2, fabs(slope) * p->disturbance_bound);
        u_s2 = -rho * h2 * h2 * z2 / (4.0 * p->epsilon2);
    }
    double wanted = k2 * v0.first - t.b0 * z1 / rho + alpha_dot + -p->ks2 * z2 + u_s2;
    double voltage = limited(wanted, -p->u_max, p->u_max);
    if (voltage == wanted)
        s->theta = advance(&t, tr, p->period, &p->theta_min, &p->theta_max);
    s->reference = next_reference(&p->reshaping, s->reference, accel);
    s->eta = filtered(p, eta, x1);
    s->v0 = filtered(p, v0, voltage);
    s->psi = filtered(p, psi, 1.0);
    return voltage;
}

static inline double dot(const double *row, const double *x)
{
    return row[0] * x[0] + row[1] * x[1] + row[2] * x[2] + row[3] * x[3];
}

static inline double shown(const valve_t *p, double position, double noise)
{
    double reading = position + p->lvdt.bias + p->lvdt.noise * noise;
    if (p->lvdt.resolution > 0.0)
        reading = p->lvdt.resolution * floor(reading / p->lvdt.resolution + 0.5);
    return reading;
}

static inline void valve_step(const valve_t *p, spool_t *s, double voltage)
{
    double force = limited(voltage, -p->u_max, p->u_max) + p->disturbance.offset -
                   (p->disturbance.flow_force + p->disturbance.stiffness_drift * s->time) * s->x[0];
    double gain = p->gain_scale * (1.0 + p->disturbance.gain_drift * s->time);
    double free_velocity = dot(p->row1, s->x) + p->input[1] * gain * force;
    if (p->disturbance.coulomb > 0.0) {
        double level = p->disturbance.coulomb;
        double mobility = p->input[1] * gain;
        if (p->disturbance.static_ratio > 1.0 && fabs(s->x[1]) < 8.0 * p->disturbance.stribeck_velocity) {
            double ratio = s->x[1] / p->disturbance.stribeck_velocity;
            level *= 1.0 + (p->disturbance.static_ratio - 1.0) * exp(-ratio * ratio);
        }
        if (p->disturbance.presliding > 0.0) {
            double a = p->period / p->disturbance.presliding;
            double moving = free_velocity - mobility * level * s->bristle;
            double sign = copysign(1.0, moving);
            double b = 1.0 + a * (mobility * level - sign * free_velocity);
            double root = sqrt(b * b + 4.0 * a * fabs(moving));
            double speed = b > 0.0 ? 2.0 * fabs(moving) / (b + root) : (root - b) / (2.0 * a);
            s->bristle = (s->bristle + a * sign * speed) / (1.0 + a * speed);
            force -= level * s->bristle;
        } else {
            double damping = level / p->disturbance.velocity_scale;
            force -= limited(damping * free_velocity / (1.0 + mobility * damping), -level, level);
            s->bristle = 0.0;
        }
    }
    double u = gain * force;
    double next[4] = {dot(p->row0, s->x) + p->input[0] * u, dot(p->row1, s->x) + p->input[1] * u,
                      dot(p->row2, s->x) + p->input[2] * u, dot(p->row3, s->x) + p->input[3] * u};
    memcpy(s->x, next, sizeof next);
    s->time += p->period;
}

/* Indices e_M, e_F, e_rms, u_rms, c_u of `count` valves of n samples each; noise is a buffer of n. */
#define RUN(law)                                                                                             \
    void run_##law(const law##_t *laws, const valve_t *valves, bitgen **generators, intptr_t count,           \
                   const double *commands, double *noise, intptr_t n, intptr_t last_begin, double *indices)   \
    {                                                                                                         \
        for (intptr_t i = 0; i < count; i++) {                                                                \
            spool_t spool = {{0.0, 0.0, 0.0, 0.0}, 0.0, 0.0};                                                 \
            law##_state state;                                                                                \
            double most = 0.0, final = 0.0, squares = 0.0, voltages = 0.0, changes = 0.0, before = 0.0;       \
            random_standard_normal_fill(generators[i], n, noise);                                             \
            law##_begin(laws + i, &state, shown(valves + i, 0.0, noise[0]));                                  \
            for (intptr_t k = 0; k < n; k++) {                                                                \
                double measurement = shown(valves + i, spool.x[0], noise[k]);                                 \
                double voltage = law##_step(laws + i, &state, commands[k], measurement);                      \
                double error = fabs(measurement - commands[k]);                                               \
                double change = k > 0 ? voltage - before : 0.0;                                               \
                if (error > most)                                                                             \
                    most = error;                                                                             \
                if (k >= last_begin && error > final)                                                         \
                    final = error;                                                                            \
                squares += error * error;                                                                     \
                voltages += voltage * voltage;                                                                \
                changes += change * change;                                                                   \
                before = voltage;                                                                             \
                valve_step(valves + i, &spool, voltage);                                                      \
            }                                                                                                 \
            double u_rms = sqrt(voltages / n);                                                                \
            indices[5 * i] = most;                                                                            \
            indices[5 * i + 1] = final;                                                                       \
            indices[5 * i + 2] = sqrt(squares / n);                                                           \
            indices[5 * i + 3] = u_rms;                                                                       \
            indices[5 * i + 4] = u_rms > 0.0 ? sqrt(changes / (n - 1)) / u_rms : 0.0;                         \
        }                                                                                                     \
    }

RUN(arc)
RUN(oarc)
