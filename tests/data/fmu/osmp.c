/* A traffic participant by OSI Sensor Model Packaging 1.x for FMI 2.0, without any library of OSI; compiled by the tests.
 *
 * It is the emergency brake of aeb.c: it reads a SensorView and says in a TrafficUpdate or MotionRequest where it is at
 * the end of the step, as `answer` says. It holds its environment to the rules of the standard: a breach is an error,
 * and the log names the rule. `record` is a file to which all that it is given is written, each message after its
 * length and the letter I (GroundTruthInit), S (SensorView), C (TrafficCommand) or V (SensorViewConfiguration). */

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { VIEW, INIT = 3, OUT = 6, ANSWER = 9, COMMAND = 10, CONFIG = 13, COMMAND_OUT = 16, N_INTEGERS = 19 };
enum { UPDATE, OTHER_ID, GARBAGE, NOTHING, NO_POSITION, ONLY_X, STATE = 10, ACCELERATION, TRAJECTORY };
enum { MAX_OBJECTS = 64, MAX_NAME = 64, MAX_OUT = 1024 };

typedef struct {
    uint64_t id;
    char name[MAX_NAME];
    double x, y, yaw, vx, vy, length, width;
} Object;

typedef struct {
    const fmi2CallbackFunctions *callbacks;
    fmi2Integer integer[N_INTEGERS];
    double reaction, since;
    int braking, is_started, init_sets, config_sets, command_sets;
    char record[1024];
    const uint8_t *last_view;
    uint8_t *last_copy;
    size_t last_size;
    double last_time;
    Object known[MAX_OBJECTS];
    int n_known;
    uint8_t out[2][MAX_OUT];
    int turn;
} Brake;

/* Reading messages of Protocol Buffers. */

typedef struct {
    const uint8_t *at, *end;
    int is_broken;
} Reader;

typedef struct {
    int number, wire;
    uint64_t integer;
    Reader content;
} Field;

static uint64_t read_varint(Reader *reader) {
    uint64_t value = 0;
    for (int shift = 0; shift < 64; shift += 7) {
        if (reader->at >= reader->end) break;
        uint8_t byte = *reader->at++;
        value |= (uint64_t)(byte & 0x7f) << shift;
        if (!(byte & 0x80)) return value;
    }
    reader->is_broken = 1;
    return 0;
}

static int read_field(Reader *reader, Field *field) {
    if (reader->is_broken || reader->at == reader->end) return 0;
    uint64_t tag = read_varint(reader), size = 0;
    field->number = (int)(tag >> 3), field->wire = (int)(tag & 7), field->integer = 0;
    if (field->wire == 0) field->integer = read_varint(reader);
    else if (field->wire == 1) size = 8;
    else if (field->wire == 5) size = 4;
    else if (field->wire == 2) size = read_varint(reader);
    else reader->is_broken = 1;
    if (reader->is_broken || size > (uint64_t)(reader->end - reader->at)) return reader->is_broken = 1, 0;
    field->content = (Reader){reader->at, reader->at + size, 0};
    if (field->wire == 1) memcpy(&field->integer, reader->at, 8);
    reader->at += size;
    return 1;
}

/* Numbers of a message whose fields are numbers, by field; doubles are bits. */
static void read_numbers(Reader *reader, Reader content, double *doubles, uint64_t *integers) {
    Field field;
    while (read_field(&content, &field)) {
        if (field.number > 3) continue;
        if (doubles) memcpy(&doubles[field.number], &field.integer, 8);
        if (integers) integers[field.number] = field.integer;
    }
    reader->is_broken |= content.is_broken;
}

static double read_time(Reader *reader, Reader content) {
    uint64_t parts[4] = {0};
    read_numbers(reader, content, NULL, parts);
    return (double)parts[1] + 1e-9 * (double)parts[2];
}

static uint64_t read_id(Reader *reader, Reader content) {
    uint64_t parts[4] = {0};
    read_numbers(reader, content, NULL, parts);
    return parts[1];
}

static void read_object(Reader *reader, Reader content, Object *object) {
    Field field, inner;
    memset(object, 0, sizeof *object);
    while (read_field(&content, &field)) {
        if (field.number == 1) object->id = read_id(&content, field.content);
        if (field.number == 2)
            while (read_field(&field.content, &inner)) {
                double values[4] = {0};
                if (inner.number > 5) continue;
                read_numbers(&content, inner.content, values, NULL);
                if (inner.number == 1) object->length = values[1], object->width = values[2];
                if (inner.number == 2) object->x = values[1], object->y = values[2];
                if (inner.number == 3) object->yaw = values[3];
                if (inner.number == 4) object->vx = values[1], object->vy = values[2];
            }
        if (field.number == 10)
            while (read_field(&field.content, &inner)) {
                size_t size = (size_t)(inner.content.end - inner.content.at);
                if (inner.number == 3 && size < MAX_NAME) memcpy(object->name, inner.content.at, size), object->name[size] = 0;
            }
        content.is_broken |= field.content.is_broken;
    }
    reader->is_broken |= content.is_broken;
}

typedef struct {
    int has_version, has_time, has_host, n_lanes, n_objects;
    double time;
    uint64_t host;
    Object objects[MAX_OBJECTS];
} Truth;

static void read_truth(Reader *reader, Reader content, Truth *truth) {
    Field field;
    memset(truth, 0, sizeof *truth);
    while (read_field(&content, &field)) {
        if (field.number == 1) truth->has_version = 1;
        if (field.number == 2) truth->has_time = 1, truth->time = read_time(&content, field.content);
        if (field.number == 3) truth->has_host = 1, truth->host = read_id(&content, field.content);
        if (field.number == 5 && truth->n_objects < MAX_OBJECTS) read_object(&content, field.content, &truth->objects[truth->n_objects++]);
        if (field.number == 10) truth->n_lanes++;
    }
    reader->is_broken |= content.is_broken;
}

/* Writing them. */

typedef struct {
    uint8_t bytes[MAX_OUT];
    size_t size;
} Writer;

static void put_varint(Writer *writer, uint64_t value) {
    for (; value > 0x7f; value >>= 7) writer->bytes[writer->size++] = (uint8_t)(value | 0x80);
    writer->bytes[writer->size++] = (uint8_t)value;
}

static void put_integer(Writer *writer, int number, uint64_t value) {
    put_varint(writer, (uint64_t)number << 3);
    put_varint(writer, value);
}

static void put_message(Writer *writer, int number, const Writer *content) {
    put_varint(writer, (uint64_t)number << 3 | 2);
    put_varint(writer, content->size);
    memcpy(writer->bytes + writer->size, content->bytes, content->size);
    writer->size += content->size;
}

static void put_vector(Writer *writer, int number, double x, double y, double z) {
    Writer content = {{0}, 0};
    double values[3] = {x, y, z};
    for (int k = 0; k < 3; k++) {
        put_varint(&content, (uint64_t)(k + 1) << 3 | 1);
        memcpy(content.bytes + content.size, &values[k], 8);
        content.size += 8;
    }
    put_message(writer, number, &content);
}

static void put_x(Writer *writer, int number, double x) {
    Writer content = {{0}, 0};
    put_varint(&content, 1 << 3 | 1);
    memcpy(content.bytes + content.size, &x, 8);
    content.size += 8;
    put_message(writer, number, &content);
}

static void put_time(Writer *writer, int number, double time) {
    Writer content = {{0}, 0};
    uint64_t nanos = (uint64_t)llround(time * 1e9);
    put_integer(&content, 1, nanos / 1000000000u);
    put_integer(&content, 2, nanos % 1000000000u);
    put_message(writer, number, &content);
}

/* The rules. */

static const uint8_t *address_of(const Brake *brake, int variable) {
    uint64_t low = (uint32_t)brake->integer[variable], high = (uint32_t)brake->integer[variable + 1];
    return (const uint8_t *)(uintptr_t)(high << 32 | low);
}

static int breach(Brake *brake, const char *rule) {
    brake->callbacks->logger(brake->callbacks->componentEnvironment, "osmp", fmi2Error, "logStatusError", "OSMP: %s", rule);
    return fmi2Error;
}

static void record(const Brake *brake, char kind, const uint8_t *bytes, uint32_t size) {
    FILE *file = brake->record[0] ? fopen(brake->record, "ab") : NULL;
    if (!file) return;
    fwrite(&kind, 1, 1, file);
    fwrite(&size, 4, 1, file);
    fwrite(bytes, 1, size, file);
    fclose(file);
}

static int check_init(Brake *brake) {
    static Truth truth;
    const uint8_t *bytes = address_of(brake, INIT);
    int size = brake->integer[INIT + 2];
    if (!brake->init_sets) return fmi2OK;
    if (!bytes || size <= 0) return breach(brake, "GroundTruthInit has an address and a size");
    Reader reader = {bytes, bytes + size, 0};
    read_truth(&reader, reader, &truth);
    if (reader.is_broken) return breach(brake, "GroundTruthInit can be parsed until the initialization ends");
    if (!truth.has_version) return breach(brake, "GroundTruthInit has a version");
    if (!truth.n_lanes) return breach(brake, "GroundTruthInit has lanes");
    if (truth.n_objects) return breach(brake, "GroundTruthInit has no moving objects");
    record(brake, 'I', bytes, (uint32_t)size);
    return fmi2OK;
}

/* A sensor may be told how its views are; what it is given has to be as it was told. */
static int check_config(Brake *brake) {
    const uint8_t *bytes = address_of(brake, CONFIG);
    int size = brake->integer[CONFIG + 2], has_version = 0, has_sensor = 0, has_mounting = 0, has_cycle = 0;
    if (!brake->config_sets) return fmi2OK;
    if (!bytes || size <= 0) return breach(brake, "SensorViewConfiguration has an address and a size");
    Reader reader = {bytes, bytes + size, 0};
    Field field;
    while (read_field(&reader, &field)) {
        if (field.number == 1) has_version = 1;
        if (field.number == 2) has_sensor = 1;
        if (field.number == 3) has_mounting = 1;
        if (field.number == 8) has_cycle = read_time(&reader, field.content) > 0.0;
    }
    if (reader.is_broken || !has_version || !has_sensor || !has_mounting || !has_cycle)
        return breach(brake, "SensorViewConfiguration has a version, a sensor id, a mounting position and a cycle time");
    record(brake, 'V', bytes, (uint32_t)size);
    return fmi2OK;
}

static int check_command(Brake *brake, uint64_t host, double time) {
    const uint8_t *bytes = address_of(brake, COMMAND);
    int size = brake->integer[COMMAND + 2], has_version = 0, has_time = 0, has_id = 0;
    if (!brake->command_sets) return fmi2OK;
    if (!bytes || size <= 0) return breach(brake, "TrafficCommand has an address and a size");
    Reader reader = {bytes, bytes + size, 0};
    Field field;
    while (read_field(&reader, &field)) {
        if (field.number == 1) has_version = 1;
        if (field.number == 2) has_time = read_time(&reader, field.content) == time;
        if (field.number == 3) has_id = read_id(&reader, field.content) == host;
        if (field.number > 4) reader.is_broken = 1;
    }
    if (reader.is_broken || !has_version || !has_time || !has_id)
        return breach(brake, "TrafficCommand has a version, the time of the SensorView and the id of the host");
    record(brake, 'C', bytes, (uint32_t)size);
    return fmi2OK;
}

static int check_objects(Brake *brake, const Truth *truth) {
    int is_host_there = 0;
    for (int k = 0; k < truth->n_objects; k++) {
        const Object *object = &truth->objects[k];
        is_host_there |= object->id == truth->host;
        for (int other = 0; other < k; other++)
            if (truth->objects[other].id == object->id) return breach(brake, "ids are unique");
        int at = 0;
        while (at < brake->n_known && brake->known[at].id != object->id) at++;
        if (at == brake->n_known && at < MAX_OBJECTS) brake->known[brake->n_known++] = *object;
        if (at < MAX_OBJECTS && strcmp(brake->known[at].name, object->name)) return breach(brake, "ids stay those of their objects");
    }
    return is_host_there ? fmi2OK : breach(brake, "the host is one of the moving objects");
}

static int read_view(Brake *brake, double now, Truth *truth) {
    const uint8_t *bytes = address_of(brake, VIEW);
    int size = brake->integer[VIEW + 2];
    if (!bytes || size <= 0) return breach(brake, "SensorView has an address and a size");
    if (brake->last_copy && memcmp(brake->last_view, brake->last_copy, brake->last_size))
        return breach(brake, "the buffer of the step before stays as it was");
    int has_version = 0, has_sensor = 0, has_mounting = 0, has_host = 0, has_time = 0, has_truth = 0;
    double time = 0.0;
    uint64_t host = 0;
    Reader reader = {bytes, bytes + size, 0};
    Field field;
    while (read_field(&reader, &field)) {
        if (field.number == 1) has_version = 1;
        if (field.number == 2) has_time = 1, time = read_time(&reader, field.content);
        if (field.number == 3) has_sensor = 1;
        if (field.number == 4) has_mounting = 1;
        if (field.number == 7) has_truth = 1, read_truth(&reader, field.content, truth);
        if (field.number == 8) has_host = 1, host = read_id(&reader, field.content);
    }
    if (reader.is_broken) return breach(brake, "SensorView can be parsed");
    if (!has_version || !has_truth || !truth->has_version) return breach(brake, "SensorView and GroundTruth have a version");
    if (!has_sensor || !has_mounting) return breach(brake, "SensorView has a sensor id and a mounting position");
    if (!has_host || !truth->has_host || host != truth->host) return breach(brake, "SensorView and GroundTruth have the same host");
    if (!has_time || !truth->has_time || time != truth->time) return breach(brake, "SensorView and GroundTruth have the same time");
    if (time > now + 1e-6) return breach(brake, "SensorView is not of the future");
    int is_new = !brake->last_copy || bytes != brake->last_view;
    if (!is_new && ((size_t)size != brake->last_size || memcmp(bytes, brake->last_copy, brake->last_size)))
        return breach(brake, "a new message is in another buffer");
    if (brake->last_copy && (time < brake->last_time || (is_new && time == brake->last_time)))
        return breach(brake, "time increases");
    if (!brake->init_sets == !truth->n_lanes) return breach(brake, "roads are told once");
    if (is_new) record(brake, 'S', bytes, (uint32_t)size);
    free(brake->last_copy);
    brake->last_view = bytes, brake->last_size = (size_t)size, brake->last_time = time;
    brake->last_copy = malloc(brake->last_size);
    memcpy(brake->last_copy, bytes, brake->last_size);
    return check_objects(brake, truth);
}

/* The brake. */

static double brake_or_not(Brake *brake, const Truth *truth, const Object *host, double size) {
    double gap = INFINITY, closing = 0.0, speed = host->vx * cos(host->yaw) + host->vy * sin(host->yaw);
    for (int k = 0; k < truth->n_objects; k++) {
        const Object *other = &truth->objects[k];
        double dx = other->x - host->x, dy = other->y - host->y;
        double along = dx * cos(host->yaw) + dy * sin(host->yaw) - 0.5 * (host->length + other->length);
        double aside = dy * cos(host->yaw) - dx * sin(host->yaw);
        if (other == host || along < 0.0 || along >= gap || fabs(aside) > 0.5 * (host->width + other->width)) continue;
        gap = along, closing = speed - (other->vx * cos(host->yaw) + other->vy * sin(host->yaw));
    }
    brake->since = closing > 0.0 && gap / closing < 2.0 ? brake->since + size : 0.0;
    brake->braking |= brake->since > brake->reaction;
    return brake->braking ? -8.0 : 0.0;
}

static void answer(Brake *brake, const Truth *truth, const Object *host, double acceleration, double now, double size) {
    int kind = brake->integer[ANSWER];
    double cosine = cos(host->yaw), sine = sin(host->yaw), speed = host->vx * cosine + host->vy * sine;
    double after = fmax(speed + acceleration * size, 0.0), step = after * size;
    /* A MotionRequest is about the middle of the rear axle; this vehicle has it 1.4 m behind its middle. */
    double behind = kind >= STATE ? 1.4 : 0.0;
    double x = host->x + (step - behind) * cosine, y = host->y + (step - behind) * sine;
    Writer message = {{0}, 0}, id = {{0}, 0}, base = {{0}, 0}, update = {{0}, 0};
    put_time(&message, 2, now + size);
    if (kind < STATE) {
        put_integer(&id, 1, host->id + (kind == OTHER_ID));
        put_message(&update, 1, &id);
        if (kind != NO_POSITION) {
            /* All of it, or only x, which comes first in a vector. */
            if (kind == ONLY_X) put_x(&base, 2, x), put_x(&base, 4, after * cosine);
            else {
                put_vector(&base, 2, x, y, 0.0);
                put_vector(&base, 3, 0.0, 0.0, host->yaw);
                put_vector(&base, 4, after * cosine, after * sine, 0.0);
            }
        }
        put_message(&update, 2, &base);
        put_message(&message, 3, &update);
    } else if (kind != TRAJECTORY) {
        put_integer(&message, 3, 0);
        put_time(&base, 1, now + size);
        if (kind == STATE) {
            put_vector(&base, 2, x, y, 0.0);
            put_vector(&base, 3, 0.0, 0.0, host->yaw);
            put_vector(&base, 4, after * cosine, after * sine, 0.0);
        } else put_vector(&base, 5, acceleration * cosine, acceleration * sine, 0.0);
        put_message(&message, 4, &base);
    } else {
        put_integer(&message, 3, 1);
        for (int k = 0; k < 2; k++) {
            Writer point = {{0}, 0};
            put_time(&point, 1, now + k * size);
            put_vector(&point, 2, k ? x : host->x - behind * cosine, k ? y : host->y - behind * sine, 0.0);
            put_vector(&point, 3, 0.0, 0.0, host->yaw);
            put_message(&base, 1, &point);
        }
        put_message(&message, 5, &base);
    }
    if (kind == GARBAGE) memset(message.bytes, 0xff, message.size);
    brake->turn = !brake->turn;
    memcpy(brake->out[brake->turn], message.bytes, message.size);
    uint64_t address = (uint64_t)(uintptr_t)brake->out[brake->turn];
    brake->integer[OUT] = (fmi2Integer)(uint32_t)address;
    brake->integer[OUT + 1] = (fmi2Integer)(uint32_t)(address >> 32);
    brake->integer[OUT + 2] = kind == NOTHING ? 0 : (fmi2Integer)message.size;
}

/* FMI. */

static void start(Brake *brake) {
    const fmi2CallbackFunctions *callbacks = brake->callbacks;
    free(brake->last_copy);
    memset(brake, 0, sizeof *brake);
    brake->callbacks = callbacks, brake->reaction = 0.1;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    Brake *brake = calloc(1, sizeof(Brake));
    brake->callbacks = callbacks;
    start(brake);
    return brake;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real tolerance, fmi2Real begin, fmi2Boolean s, fmi2Real end) { return fmi2OK; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return ((Brake *)c)->is_started = 1, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    int status = check_init(c);
    return status == fmi2OK ? check_config(c) : status;
}
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return start(c), fmi2OK; }

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer values[]) {
    Brake *brake = c;
    for (size_t k = 0; k < n; k++) {
        brake->integer[vr[k]] = values[k];
        brake->config_sets += vr[k] == CONFIG, brake->command_sets += vr[k] == COMMAND;
        if (vr[k] != INIT) continue;
        if (brake->is_started || brake->init_sets++) return breach(brake, "GroundTruthInit is set once, before the initialization");
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer values[]) {
    for (size_t k = 0; k < n; k++) values[k] = ((Brake *)c)->integer[vr[k]];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real values[]) {
    if (n) ((Brake *)c)->reaction = values[0];
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real values[]) {
    if (n) values[0] = ((Brake *)c)->reaction;
    return fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String values[]) {
    if (n) snprintf(((Brake *)c)->record, sizeof ((Brake *)c)->record, "%s", values[0]);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean keep) {
    static Truth truth;
    Brake *brake = c;
    int status = read_view(brake, time, &truth);
    if (status != fmi2OK) return status;
    if ((status = check_command(brake, truth.host, brake->last_time)) != fmi2OK) return status;
    const Object *host = truth.objects;
    while (host->id != truth.host) host++;
    answer(brake, &truth, host, brake_or_not(brake, &truth, host, size), time, size);
    return fmi2OK;
}

void fmi2FreeInstance(fmi2Component c) {
    free(((Brake *)c)->last_copy);
    free(c);
}
