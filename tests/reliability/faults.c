/* Lets one order to the system fail: the n-th that concerns a file under a folder. Loaded before the C library. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static char under[PATH_MAX];
static char last[64];
static long turn, given;
static int error_number, full, is_full;

/* From now on the n-th order fails (0: none); where `stays_full`, a write is cut in half and no more can be written. */
void faults_arm(const char *folder, long n, int number, int stays_full) {
    snprintf(under, sizeof under, "%s", folder);
    turn = n; error_number = number; full = stays_full; given = 0; is_full = 0; last[0] = 0;
}
long faults_given(void) { return given; }
const char *faults_last(void) { return last; }

static int concerns_path(int folder, const char *path) {
    char whole[PATH_MAX], name[64];
    size_t length = strlen(under);
    if (!length || !path) return 0;
    if (path[0] == '/') return !strncmp(path, under, length);
    if (folder == AT_FDCWD) return getcwd(whole, sizeof whole) && !strncmp(whole, under, length);
    snprintf(name, sizeof name, "/proc/self/fd/%d", folder);
    ssize_t n = readlink(name, whole, sizeof whole - 1);
    return n > 0 && (whole[n] = 0, !strncmp(whole, under, length));
}

static int concerns(int file) {
    char whole[PATH_MAX], name[64];
    size_t length = strlen(under);
    if (!length) return 0;
    int before = errno;
    snprintf(name, sizeof name, "/proc/self/fd/%d", file);
    ssize_t n = readlink(name, whole, sizeof whole - 1);
    errno = before;
    return n > 0 && (whole[n] = 0, !strncmp(whole, under, length));
}

/* Whether this order fails. */
static int fails(const char *name, int takes_room) {
    given++;
    if (is_full && takes_room) { errno = ENOSPC; return 1; }
    if (given != turn) return 0;
    snprintf(last, sizeof last, "%s", name);
    if (full) { is_full = 1; if (!takes_room) return 0; }
    errno = full ? ENOSPC : error_number;
    return 1;
}

#define REAL(name) static __typeof__(&name) real; if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)
#define MODE int mode = 0; if (flags & (O_CREAT | __O_TMPFILE)) { va_list more; va_start(more, flags); \
    mode = va_arg(more, int); va_end(more); }

int open(const char *path, int flags, ...) {
    REAL(open); MODE
    return concerns_path(AT_FDCWD, path) && fails("open", flags & O_CREAT) ? -1 : real(path, flags, mode);
}
int open64(const char *path, int flags, ...) {
    REAL(open64); MODE
    return concerns_path(AT_FDCWD, path) && fails("open", flags & O_CREAT) ? -1 : real(path, flags, mode);
}
int openat(int folder, const char *path, int flags, ...) {
    REAL(openat); MODE
    return concerns_path(folder, path) && fails("open", flags & O_CREAT) ? -1 : real(folder, path, flags, mode);
}
int openat64(int folder, const char *path, int flags, ...) {
    REAL(openat64); MODE
    return concerns_path(folder, path) && fails("open", flags & O_CREAT) ? -1 : real(folder, path, flags, mode);
}

/* What is left of a disk takes half of what is written. */
static size_t half(size_t count, int was_full) { return full && is_full && !was_full ? count / 2 : 0; }

ssize_t write(int file, const void *bytes, size_t count) {
    REAL(write);
    int before = is_full;
    if (!concerns(file) || !fails("write", 1)) return real(file, bytes, count);
    size_t part = half(count, before);
    return part ? real(file, bytes, part) : -1;
}
ssize_t pwrite(int file, const void *bytes, size_t count, off_t at) {
    REAL(pwrite);
    int before = is_full;
    if (!concerns(file) || !fails("write", 1)) return real(file, bytes, count, at);
    size_t part = half(count, before);
    return part ? real(file, bytes, part, at) : -1;
}
ssize_t pwrite64(int file, const void *bytes, size_t count, off64_t at) {
    REAL(pwrite64);
    int before = is_full;
    if (!concerns(file) || !fails("write", 1)) return real(file, bytes, count, at);
    size_t part = half(count, before);
    return part ? real(file, bytes, part, at) : -1;
}
ssize_t writev(int file, const struct iovec *parts, int count) {
    REAL(writev);
    return concerns(file) && fails("write", 1) ? -1 : real(file, parts, count);
}
ssize_t copy_file_range(int from, off64_t *at, int to, off64_t *to_at, size_t count, unsigned flags) {
    REAL(copy_file_range);
    return concerns(to) && fails("write", 1) ? -1 : real(from, at, to, to_at, count, flags);
}
int fsync(int file) { REAL(fsync); return concerns(file) && fails("fsync", 0) ? -1 : real(file); }
int fdatasync(int file) { REAL(fdatasync); return concerns(file) && fails("fsync", 0) ? -1 : real(file); }
int ftruncate(int file, off_t size) { REAL(ftruncate); return concerns(file) && fails("truncate", 1) ? -1 : real(file, size); }
int ftruncate64(int file, off64_t size) { REAL(ftruncate64); return concerns(file) && fails("truncate", 1) ? -1 : real(file, size); }
int fchmod(int file, mode_t mode) { REAL(fchmod); return concerns(file) && fails("chmod", 0) ? -1 : real(file, mode); }
int chmod(const char *path, mode_t mode) {
    REAL(chmod);
    return concerns_path(AT_FDCWD, path) && fails("chmod", 0) ? -1 : real(path, mode);
}
int rename(const char *from, const char *to) {
    REAL(rename);
    return concerns_path(AT_FDCWD, to) && fails("rename", 0) ? -1 : real(from, to);
}
int renameat(int a, const char *from, int b, const char *to) {
    REAL(renameat);
    return concerns_path(b, to) && fails("rename", 0) ? -1 : real(a, from, b, to);
}
int mkdir(const char *path, mode_t mode) {
    REAL(mkdir);
    return concerns_path(AT_FDCWD, path) && fails("mkdir", 1) ? -1 : real(path, mode);
}
int mkdirat(int folder, const char *path, mode_t mode) {
    REAL(mkdirat);
    return concerns_path(folder, path) && fails("mkdir", 1) ? -1 : real(folder, path, mode);
}
int unlink(const char *path) {
    REAL(unlink);
    return concerns_path(AT_FDCWD, path) && fails("unlink", 0) ? -1 : real(path);
}
int unlinkat(int folder, const char *path, int flags) {
    REAL(unlinkat);
    return concerns_path(folder, path) && fails("unlink", 0) ? -1 : real(folder, path, flags);
}
