/* A function with an interface of FMI 2.0 that keeps its speed and steers towards a point of its path. */

#include <math.h>
#include <stdlib.h>

#include "fmi2Functions.h"

enum { X, Y, WHEELBASE, ACCELERATION, STEERING, N_REALS };

static fmi2Status step(double *real) {
    real[STEERING] = atan(2.0 * real[WHEELBASE] * real[Y] / (real[X] * real[X] + real[Y] * real[Y]));
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    return calloc(N_REALS, sizeof(double));
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real tolerance, fmi2Real begin, fmi2Boolean s, fmi2Real end) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
    for (int k = 0; k < N_REALS; k++) ((double *)c)[k] = 0.0;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real values[]) {
    for (size_t k = 0; k < n; k++) values[k] = ((double *)c)[vr[k]];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real values[]) {
    for (size_t k = 0; k < n; k++) ((double *)c)[vr[k]] = values[k];
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean keep) { return step(c); }
