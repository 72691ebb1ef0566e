/* A trained model of sphrom as a Functional Mock-up Unit (FMI 2.0, for co-simulation and model
   exchange). model.h has its arrays; the documentation of sphrom, "Take a model along", their
   meaning. The last state is the accumulated residual, from which errors are estimated. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "model.h"

#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif
typedef enum { OK, WARNING, DISCARD, FAILED, FATAL, PENDING } Status;
typedef struct {
    int new_states_needed, terminate, nominals_changed, values_changed, next_event_defined;
    double next_event;
} EventInfo;
typedef unsigned int Reference;
typedef const char *String;

enum { N_VALUES = N_MODES + N_OWN + N_ROWS, N_STATES = N + 1, N_UNKNOWN = N_OUTPUTS + 2 };

typedef struct {
    double parameters[N_PARAMETERS], driving, own_driving, time, state[N_STATES];
    double dynamics[N_POWERS * N * M], pressure[N_POWERS * N_OWN * M_ALL + 1];
    double loads[N_POWERS * N_ROWS * M_ALL + 1], residual[N_POWERS * N_RESIDUALS * M_ALL + 1];
    double uniform[2 * N_ROWS + 1], amplitude[N_AMPLITUDES], mean;
    double added[N_SNAPSHOTS * N_VALUES], expected[N_SNAPSHOTS * N_MODES], noise[N_OUTPUTS + 1];
    double constants[2], outside;
    double outputs[N_OUTPUTS + N_UNKNOWN + 1];
} Model;

/* The sum over the products of parameters of arrays with n values each. */
static void combine(const double *arrays, int n, const double *factors, int n_factors, double *out) {
    memset(out, 0, n * sizeof *out);
    for (int k = 0; k < n_factors; k++)
        for (int i = 0; i < n; i++) out[i] += factors[k] * arrays[(size_t)k * n + i];
}

static void monomials(const double *x, int n, double *out) {
    double *next = out + 1 + n;
    out[0] = 1;
    for (int i = 0; i < n; i++) {
        out[1 + i] = x[i];
        for (int j = i; j < n; j++) *next++ = x[i] * x[j];
    }
}

/* Values of n_rows polynomials with coefficients (N_POWERS, n_rows, width). */
static void evaluate(const double *c, int n_rows, int width, double beta, const double *x, double *out) {
    double factor = 1;
    memset(out, 0, n_rows * sizeof *out);
    for (int power = 0; power < N_POWERS; power++, factor *= beta)
        for (int i = 0; i < n_rows; i++, c += width) {
            double sum = 0;
            for (int k = 0; k < width; k++) sum += c[k] * x[k];
            out[i] += factor * sum;
        }
}

static double distance(const double *a, const double *b) {
    double square = 0;
    for (int i = 0; i < N_PARAMETERS; i++) square += (a[i] - b[i]) * (a[i] - b[i]);
    return sqrt(square);
}

/* A row at a time, linear between snapshots; constant after the last one. */
static void at_time(const double *rows, int n, double time, double *out) {
    double u = fmin(fmax((time - START_TIME) / INTERVAL, 0), N_SNAPSHOTS - 1);
    int s = (int)fmin(u, N_SNAPSHOTS - 2);
    for (int i = 0; i < n; i++)
        out[i] = rows[s * n + i] + (u - s) * (rows[(s + 1) * n + i] - rows[s * n + i]);
}

static double amplitude(const Model *m, double time) {
    double u = fmin(fmax((time - START_TIME) / AMPLITUDE_INTERVAL, 0), N_AMPLITUDES - 1), own = 0;
    int first = (int)fmin(fmax(floor(u) - 1, 0), N_AMPLITUDES - 4);
    for (int i = 0; i < 4; i++) {  /* the cubic through four values */
        double weight = 1;
        for (int j = 0; j < 4; j++) if (j != i) weight *= (u - first - j) / (i - j);
        own += weight * m->amplitude[first + i];
    }
    return m->own_driving != 0 ? own : m->driving;
}

/* Solves a system of n equations without pivots; it is symmetric and positive. */
static void solve(double *a, double *b, int n) {
    for (int i = 0; i < n; i++)
        for (int r = i + 1; r < n; r++) {
            double f = a[r * n + i] / a[i * n + i];
            for (int c = i; c < n; c++) a[r * n + c] -= f * a[i * n + c];
            b[r] -= f * b[i];
        }
    for (int i = n - 1; i >= 0; i--) {
        for (int c = i + 1; c < n; c++) b[i] -= a[i * n + c] * b[c];
        b[i] /= a[i * n + i];
    }
}

/* Weights of linear interpolation between training runs; returns the distance from their hull.
   They are the least squares with weights >= 0 of the documentation (Lawson and Hanson 1974). */
static double interpolation(const double *place, double *w) {
    enum { N_ROWS_ = N_PARAMETERS + 2 };
    double row[N_TRAINED][N_ROWS_], gram[N_TRAINED * N_TRAINED], z[N_TRAINED], largest = 0, missed = 0, sum = 0;
    int used[N_TRAINED] = {0}, near = 0;
    memset(w, 0, N_TRAINED * sizeof *w);
    for (int k = 0; k < N_TRAINED; k++) {
        largest = fmax(largest, distance(TRAINED + k * N_PARAMETERS, place));
        if (distance(TRAINED + k * N_PARAMETERS, place) < distance(TRAINED + near * N_PARAMETERS, place)) near = k;
    }
    w[near] = 1;
    if (distance(TRAINED + near * N_PARAMETERS, place) <= 1e-12 * largest) return 0;
    w[near] = 0;
    for (int k = 0; k < N_TRAINED; k++) {
        double d = distance(TRAINED + k * N_PARAMETERS, place) / largest;
        for (int i = 0; i < N_PARAMETERS; i++) row[k][i] = (TRAINED[k * N_PARAMETERS + i] - place[i]) / largest;
        row[k][N_PARAMETERS] = 1;
        row[k][N_PARAMETERS + 1] = 1e-4 * d * d;
    }
    for (int step = 0; step < 10 * N_TRAINED; step++) {
        int best = -1;
        double slope = 1e-14, rest[N_ROWS_] = {0};
        rest[N_PARAMETERS] = 1;
        for (int k = 0; k < N_TRAINED; k++) for (int i = 0; i < N_ROWS_; i++) rest[i] -= w[k] * row[k][i];
        for (int k = 0; k < N_TRAINED; k++) {
            double g = 0;
            for (int i = 0; i < N_ROWS_; i++) g += row[k][i] * rest[i];
            if (!used[k] && g > slope) slope = g, best = k;
        }
        if (best < 0) break;
        used[best] = 1;
        for (;;) {
            int index[N_TRAINED], n = 0, negative = 0;
            double share = 1;
            for (int k = 0; k < N_TRAINED; k++) if (used[k]) index[n++] = k;
            for (int i = 0; i < n; i++) {
                z[i] = row[index[i]][N_PARAMETERS];
                for (int j = 0; j < n; j++) {
                    gram[i * n + j] = 0;
                    for (int r = 0; r < N_ROWS_; r++) gram[i * n + j] += row[index[i]][r] * row[index[j]][r];
                    /* Evenness: points at the same distance get the same weights. */
                    if (i == j) gram[i * n + j] += 1e-12;
                }
            }
            solve(gram, z, n);
            for (int i = 0; i < n; i++)
                if (z[i] <= 0) negative = 1, share = fmin(share, w[index[i]] / (w[index[i]] - z[i]));
            for (int i = 0; i < n; i++) {
                double *x = w + index[i];
                *x = negative ? *x + share * (z[i] - *x) : z[i];
                if (*x <= 1e-15) *x = 0, used[index[i]] = 0;
            }
            if (!negative) break;
        }
    }
    for (int k = 0; k < N_TRAINED; k++) sum += w[k];
    for (int k = 0; k < N_TRAINED; k++) w[k] /= sum;
    for (int i = 0; i < N_PARAMETERS; i++) {
        double offset = 0;
        for (int k = 0; k < N_TRAINED; k++) offset += w[k] * row[k][i];
        missed += offset * offset;
    }
    return sqrt(missed) > 1e-6 ? sqrt(missed) * largest : 0;
}

/* Computes all that depends on the parameters alone. */
static void prepare(Model *m, int start) {
    double factors[N_PRODUCTS], place[N_PARAMETERS], scaled[N_PARAMETERS], w[N_TRAINED], between = 0;
    int nearest = 0;
    for (int i = 0; i < N_PARAMETERS; i++) {
        scaled[i] = m->parameters[i] / SCALES[i];
        place[i] = LOGARITHMS[i] != 0 ? log(m->parameters[i]) : scaled[i];
    }
    for (int k = 0; k < N_PRODUCTS; k++) {
        factors[k] = 1;
        for (int i = 0; i <= N_PARAMETERS; i++)  /* the last one is the viscosity */
            if (PRODUCTS[k * (N_PARAMETERS + 1) + i] != 0)
                factors[k] *= i < N_PARAMETERS ? m->parameters[i] : VISCOSITY / m->parameters[0];
    }
    combine(DYNAMICS, N_POWERS * N * M, factors, N_PRODUCTS, m->dynamics);
    combine(PRESSURE, N_POWERS * N_OWN * M_ALL, factors, N_PRODUCTS, m->pressure);
    combine(LOADS, N_POWERS * N_ROWS * M_ALL, factors, N_PRODUCTS, m->loads);
    combine(RESIDUAL, N_POWERS * N_RESIDUALS * M_ALL, factors, N_PRODUCTS, m->residual);
    combine(UNIFORM, 2 * N_ROWS, factors, N_PRODUCTS, m->uniform);
    combine(AMPLITUDE, N_AMPLITUDES, factors, N_PRODUCTS, m->amplitude);
    for (int k = 1; k < N_STARTS; k++)
        if (distance(START_PLACES + k * N_PARAMETERS, scaled) < distance(START_PLACES + nearest * N_PARAMETERS, scaled)) nearest = k;
    m->mean = MEANS[nearest];
    if (start) {
        memcpy(m->state, STARTS + nearest * N, N * sizeof *m->state);
        m->state[N] = 0;
    }
    memset(m->added, 0, sizeof m->added);
    for (int e = 0; e < N_ENTRIES; e++)  /* corrections: each entry has a row of places and values */
        for (int k = 0; k < ENTRY_RUNS[e]; k++) {
            const double *at = ENTRY_PLACES[e] + k * N_PARAMETERS, *values = ENTRY_VALUES[e] + (size_t)k * N_SNAPSHOTS;
            double weight = exp(-distance(at, place) / ENTRY_LENGTHS[e]);
            for (int s = 0; s < N_SNAPSHOTS; s++) m->added[s * N_VALUES + ENTRY_TARGETS[e]] += weight * values[s];
        }
    if (!HAS_ERRORS) return;
    m->outside = interpolation(place, w);
    combine(EXPECTED, N_SNAPSHOTS * N_MODES, w, N_TRAINED, m->expected);
    for (int k = 0; k < N_TRAINED; k++)
        for (int j = 0; j < k; j++) between = fmax(between, distance(TRAINED + k * N_PARAMETERS, TRAINED + j * N_PARAMETERS));
    for (int f = 0; f < 2; f++) {
        double mean = 0, low = INFINITY, high = -INFINITY;
        for (int k = 0; k < N_TRAINED; k++) {
            double x = log(CONSTANTS[2 * k + f]);
            mean += w[k] * x, low = fmin(low, x), high = fmax(high, x);
        }
        m->constants[f] = exp(mean + (between > 0 ? fmin(1, m->outside / between) * (high - low) : 0));
    }
}

/* Coordinates with their correction. It is that of the case's history, for an input too: even then
   it makes most errors smaller. */
static void coordinates(const Model *m, double time, const double *state, double *values, double *all) {
    at_time(m->added, N_VALUES, time, values);
    for (int i = 0; i < N; i++) values[i] += state[i];
    monomials(values, N_MODES, all);
}

static void rates(const Model *m, double time, const double *state, double *out) {
    double x[M], values[N_VALUES], all[M_ALL], rest[N_RESIDUALS + 1], square = 0;
    monomials(state, N, x);
    evaluate(m->dynamics, N, M, amplitude(m, time), x, out);
    out[N] = 0;
    if (!HAS_ERRORS) return;
    coordinates(m, time, state, values, all);
    evaluate(m->residual, N_RESIDUALS, M_ALL, amplitude(m, time), all, rest);
    for (int i = 0; i < N_RESIDUALS; i++) square += rest[i] * rest[i];
    out[N] = sqrt(square) - DECAY * state[N];
}

static void compute(Model *m) {
    double values[N_VALUES], all[M_ALL], more[N_OWN + N_ROWS + 1], terms[2 + N_MODES + N_OWN];
    double beta = amplitude(m, m->time), *y = m->outputs, *errors = y + N_OUTPUTS, known[2], change = 0, expected[N_MODES];
    coordinates(m, m->time, m->state, values, all);
    evaluate(m->pressure, N_OWN, M_ALL, beta, all, more);
    evaluate(m->loads, N_ROWS, M_ALL, beta, all, more + N_OWN);
    for (int i = 0; i < N_OWN + N_ROWS; i++) values[N_MODES + i] += more[i];
    terms[0] = 1, terms[1] = m->mean;
    memcpy(terms + 2, values, (N_MODES + N_OWN) * sizeof *terms);
    for (int o = 0; o < N_LINEAR; o++) {
        y[o] = 0;
        for (int i = 0; i < 2 + N_MODES + N_OWN; i++) y[o] += LINEAR[o * (2 + N_MODES + N_OWN) + i] * terms[i];
    }
    for (int r = 0; r < N_ROWS; r++) {
        double sum = values[N_MODES + N_OWN + r] + m->mean * (m->uniform[r] + beta * m->uniform[N_ROWS + r]);
        for (int i = 0; i < N_OWN; i++) sum += OWN[r * N_OWN + i] * values[N_MODES + i];
        y[N_LINEAR + r] = sum;
    }
    errors[N_UNKNOWN] = !HAS_ERRORS || m->outside > 0 || m->own_driving == 0;
    for (int o = 0; o < N_UNKNOWN; o++) errors[o] = -1;  /* unknown */
    if (!HAS_ERRORS || m->own_driving == 0) return;
    at_time(m->expected, N_MODES, m->time, expected);
    at_time(NOISE, N_OUTPUTS, m->time, m->noise);
    for (int i = 0; i < N_MODES; i++) change += (values[i] - expected[i]) * (values[i] - expected[i]);
    for (int f = 0; f < 2; f++) {
        known[f] = UNITS[f] * hypot(m->constants[f] * m->state[N], sqrt(change) * SHARES[f]);
        if (known[f] < INFINITY) errors[N_OUTPUTS + f] = known[f];  /* not where a run has diverged */
    }
    for (int o = 0; o < N_OUTPUTS; o++) {
        double square = m->noise[o] + OUTPUT_SHARES[o] * known[(int)FIELDS[o]] * known[(int)FIELDS[o]];
        if (square >= 0 && square < INFINITY) errors[o] = sqrt(square);
    }
}

/* Runge-Kutta steps that are stable, and much shorter than the fastest sound of the model. */
static void advance(Model *m, double h) {
    int n = (int)fmax(1, ceil(h / STEP - 1e-9));
    double d = h / n, k[4][N_STATES], x[N_STATES], start = m->time;
    for (int s = 0; s < n; s++) {
        double t = start + s * d;
        for (int stage = 0; stage < 4; stage++) {
            double share = stage == 0 ? 0 : stage == 3 ? d : d / 2;
            for (int i = 0; i < N_STATES; i++) x[i] = m->state[i] + (stage ? share * k[stage - 1][i] : 0);
            rates(m, t + share, x, k[stage]);
        }
        for (int i = 0; i < N_STATES; i++) m->state[i] += d / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
    }
    m->time = start + h;
}

API String fmi2GetTypesPlatform(void) { return "default"; }
API String fmi2GetVersion(void) { return "2.0"; }
API Status fmi2SetDebugLogging(void *c, int on, size_t n, const String names[]) { return OK; }
API Status fmi2Reset(void *c) {
    Model *m = c;
    memset(m, 0, sizeof *m);
    memcpy(m->parameters, DEFAULTS, sizeof m->parameters);
    m->own_driving = 1;
    m->time = START_TIME;
    return OK;
}
API void *fmi2Instantiate(String name, int type, String guid, String where, const void *callbacks, int visible, int logging) {
    Model *m = strcmp(guid, GUID) ? NULL : malloc(sizeof *m);
    if (m) fmi2Reset(m);
    return m;
}
API void fmi2FreeInstance(void *c) { free(c); }
API Status fmi2SetupExperiment(void *c, int has_tolerance, double tolerance, double start, int has_stop, double stop) {
    ((Model *)c)->time = start;
    return OK;
}
API Status fmi2EnterInitializationMode(void *c) { prepare(c, 1); return OK; }
API Status fmi2ExitInitializationMode(void *c) { prepare(c, 1); return OK; }
API Status fmi2Terminate(void *c) { return OK; }

/* References, BLOCK each: parameters, the input and its switch, outputs, states, rates. */
API Status fmi2GetReal(void *c, const Reference v[], size_t n, double x[]) {
    Model *m = c;
    double rate[N_STATES];
    int has_outputs = 0, has_rates = 0;
    for (size_t i = 0; i < n; i++) {
        unsigned kind = v[i] / BLOCK, k = v[i] % BLOCK;
        if (kind == 2 && !has_outputs++) compute(m);
        if (kind == 4 && !has_rates++) rates(m, m->time, m->state, rate);
        x[i] = kind == 0 ? m->parameters[k] : kind == 1 ? (k ? m->own_driving : m->driving)
             : kind == 2 ? m->outputs[k] : kind == 3 ? m->state[k] : rate[k];
    }
    return OK;
}
API Status fmi2SetReal(void *c, const Reference v[], size_t n, const double x[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        unsigned kind = v[i] / BLOCK, k = v[i] % BLOCK;
        if (kind > 1) return FAILED;
        *(kind == 0 ? m->parameters + k : k ? &m->own_driving : &m->driving) = x[i];
    }
    return OK;
}
API Status fmi2DoStep(void *c, double time, double h, int no_earlier) {
    Model *m = c;
    double square = 0;
    m->time = time;
    advance(m, h);
    for (int i = 0; i < N; i++) square += m->state[i] * m->state[i];
    return sqrt(square) <= LARGEST ? OK : FAILED;
}
API Status fmi2EnterEventMode(void *c) { return OK; }
API Status fmi2NewDiscreteStates(void *c, EventInfo *info) { memset(info, 0, sizeof *info); return OK; }
API Status fmi2EnterContinuousTimeMode(void *c) { return OK; }
API Status fmi2CompletedIntegratorStep(void *c, int no_earlier, int *event, int *stop) { *event = *stop = 0; return OK; }
API Status fmi2SetTime(void *c, double time) { ((Model *)c)->time = time; return OK; }
API Status fmi2SetContinuousStates(void *c, const double x[], size_t n) { memcpy(((Model *)c)->state, x, n * sizeof *x); return OK; }
API Status fmi2GetContinuousStates(void *c, double x[], size_t n) { memcpy(x, ((Model *)c)->state, n * sizeof *x); return OK; }
API Status fmi2GetDerivatives(void *c, double x[], size_t n) { rates(c, ((Model *)c)->time, ((Model *)c)->state, x); return OK; }
API Status fmi2GetEventIndicators(void *c, double x[], size_t n) { return OK; }
API Status fmi2GetNominalsOfContinuousStates(void *c, double x[], size_t n) { for (size_t i = 0; i < n; i++) x[i] = 1; return OK; }
API Status fmi2GetFMUstate(void *c, void **state) {
    if (!*state) *state = malloc(sizeof(Model));
    return *state ? memcpy(*state, c, sizeof(Model)), OK : FAILED;
}
API Status fmi2SetFMUstate(void *c, void *state) { memcpy(c, state, sizeof(Model)); return OK; }
API Status fmi2FreeFMUstate(void *c, void **state) { free(*state); *state = NULL; return OK; }
API Status fmi2SerializedFMUstateSize(void *c, void *state, size_t *n) { *n = sizeof(Model); return OK; }
API Status fmi2SerializeFMUstate(void *c, void *state, char bytes[], size_t n) { memcpy(bytes, state, n); return OK; }
API Status fmi2DeSerializeFMUstate(void *c, const char bytes[], size_t n, void **state) {
    *state = NULL;
    fmi2GetFMUstate(c, state);
    return *state ? memcpy(*state, bytes, n), OK : FAILED;
}

/* It has no other variables, no directional derivatives and no asynchronous steps. */
#define LACKS(name, ...) API Status name(void *c, __VA_ARGS__) { return FAILED; }
LACKS(fmi2GetInteger, const Reference v[], size_t n, int x[])
LACKS(fmi2GetBoolean, const Reference v[], size_t n, int x[])
LACKS(fmi2GetString, const Reference v[], size_t n, String x[])
LACKS(fmi2SetInteger, const Reference v[], size_t n, const int x[])
LACKS(fmi2SetBoolean, const Reference v[], size_t n, const int x[])
LACKS(fmi2SetString, const Reference v[], size_t n, const String x[])
LACKS(fmi2GetDirectionalDerivative, const Reference a[], size_t n, const Reference b[], size_t k, const double x[], double y[])
LACKS(fmi2SetRealInputDerivatives, const Reference v[], size_t n, const int orders[], const double x[])
LACKS(fmi2GetRealOutputDerivatives, const Reference v[], size_t n, const int orders[], double x[])
LACKS(fmi2GetStatus, int kind, Status *x)
LACKS(fmi2GetRealStatus, int kind, double *x)
LACKS(fmi2GetIntegerStatus, int kind, int *x)
LACKS(fmi2GetBooleanStatus, int kind, int *x)
LACKS(fmi2GetStringStatus, int kind, String *x)
API Status fmi2CancelStep(void *c) { return FAILED; }
