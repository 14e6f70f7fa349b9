/* An emergency brake with an FMI interface; compiled by the tests with -DFMI=2 or -DFMI=3.
 *
 * It brakes once the time to collision has been below `threshold` for the time `reaction`, and never lets go.
 * At `fault_time`, or when it brakes if that is negative, it does what `fault` says. With -DONCE it can be instantiated once per process. */

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#if FMI == 2
#include "fmi2Functions.h"
#define F(name) fmi2##name
#else
#include "fmi3Functions.h"
#define F(name) fmi3##name
#endif

enum { SPEED, GAP, CLOSING, REACTION, THRESHOLD, FAULT_TIME, ACCELERATION, N_REALS };
enum { NO_FAULT, CRASH, HANG, ERROR_STATUS, FATAL_STATUS, NAN_OUTPUT, NO_RESET, SLOW };

typedef struct {
    double real[N_REALS];
    int fault, braking, kept;
    double since;
#if FMI == 2
    const fmi2CallbackFunctions *callbacks;
#else
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
#endif
} Brake;

static void start(Brake *brake) {
    int kept = brake->kept;
    double reals[N_REALS] = {0.0, 1000.0, 0.0, 0.1, 2.0, 1.0, 0.0};
    for (int k = 0; k < N_REALS; k++) brake->real[k] = reals[k];
    brake->fault = NO_FAULT;
    brake->braking = 0;
    brake->since = 0.0;
    brake->kept = kept;
}

static void log_error(Brake *brake, const char *text, int number) {
    char line[200];
    snprintf(line, sizeof line, "%s %d", text, number);
#if FMI == 2
    brake->callbacks->logger(brake->callbacks->componentEnvironment, "aeb", fmi2Error, "logStatusError", "%s %d", text, number);
#else
    brake->log(brake->environment, fmi3Error, "logStatusError", line);
#endif
}

static void *instantiate(void) {
#ifdef ONCE
    static int instances = 0;
    if (instances++) return NULL;
#endif
    Brake *brake = calloc(1, sizeof(Brake));
    start(brake);
    return brake;
}

static int step(Brake *brake, double time, double size) {
    double *real = brake->real;
    if (real[CLOSING] > 0.0 && real[GAP] / real[CLOSING] < real[THRESHOLD]) brake->since += size;
    else brake->since = 0.0;
    if (brake->since > real[REACTION]) brake->braking = 1;
    real[ACCELERATION] = brake->braking || brake->kept ? -8.0 : 0.0;
    if (brake->fault == NO_RESET && brake->braking) brake->kept = 1;
    int is_due = real[FAULT_TIME] < 0.0 ? brake->braking : time + size >= real[FAULT_TIME] - 1e-9;
    if (brake->fault == NO_FAULT || !is_due) return 0;
    switch (brake->fault) {
    case CRASH:
        log_error(brake, "about to crash", 1);
        abort();
    case HANG:
        log_error(brake, "about to hang", 2);
        for (volatile int k = 0;; k++) {}
    case ERROR_STATUS:
        log_error(brake, "lost the\x1b[31m sensor", 3);
        return 3;
    case FATAL_STATUS:
        log_error(brake, "broken", 4);
        return 4;
    case NAN_OUTPUT:
        real[ACCELERATION] = 0.0 / 0.0;
        break;
    case SLOW:
        usleep(150000);
    }
    return 0;
}

#if FMI == 2

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    Brake *brake = instantiate();
    if (brake) brake->callbacks = callbacks;
    return brake;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real tolerance, fmi2Real begin, fmi2Boolean s, fmi2Real end) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) { return fmi2OK; }

#define ACCESS(NAME, TYPE, MEMBER, SETTER)                                                              \
    fmi2Status fmi2Get##NAME(fmi2Component c, const fmi2ValueReference vr[], size_t n, TYPE values[]) { \
        for (size_t k = 0; k < n; k++) values[k] = ((Brake *)c)->MEMBER;                                \
        return fmi2OK;                                                                                  \
    }                                                                                                   \
    fmi2Status fmi2Set##NAME(fmi2Component c, const fmi2ValueReference vr[], size_t n, const TYPE values[]) { \
        for (size_t k = 0; k < n; k++) ((Brake *)c)->MEMBER = values[k];                                \
        return fmi2OK;                                                                                  \
    }
ACCESS(Real, fmi2Real, real[vr[k]], )
ACCESS(Integer, fmi2Integer, fault, )

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean keep) { return step(c, time, size); }

#else

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference intermediate[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    Brake *brake = instantiate();
    if (brake) brake->environment = environment, brake->log = log;
    return brake;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean t, fmi3Float64 tolerance, fmi3Float64 begin, fmi3Boolean s, fmi3Float64 end) { return fmi3OK; }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) { return fmi3OK; }

#define ACCESS(NAME, TYPE, MEMBER)                                                                                      \
    fmi3Status fmi3Get##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, TYPE values[], size_t nv) {       \
        for (size_t k = 0; k < n; k++) values[k] = ((Brake *)c)->MEMBER;                                                \
        return fmi3OK;                                                                                                  \
    }                                                                                                                   \
    fmi3Status fmi3Set##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const TYPE values[], size_t nv) { \
        for (size_t k = 0; k < n; k++) ((Brake *)c)->MEMBER = values[k];                                                \
        return fmi3OK;                                                                                                  \
    }
ACCESS(Float64, fmi3Float64, real[vr[k]])
ACCESS(Int32, fmi3Int32, fault)

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean keep, fmi3Boolean *event,
                      fmi3Boolean *ended, fmi3Boolean *early, fmi3Float64 *reached) {
    *event = *ended = *early = fmi3False;
    *reached = time + size;
    return step(c, time, size);
}

#endif

#if FMI == 2
#define INSTANCE fmi2Component
#else
#define INSTANCE fmi3Instance
#endif
F(Status) F(ExitInitializationMode)(INSTANCE c) { return F(OK); }
F(Status) F(Terminate)(INSTANCE c) { return F(OK); }
F(Status) F(Reset)(INSTANCE c) { start(c); return F(OK); }
void F(FreeInstance)(INSTANCE c) { free(c); }
