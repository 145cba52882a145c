/* Loaded before the C library (LD_PRELOAD): counts what changes files below a folder, and lets one such call fail.

   arm(folder, at, how) begins to count at 1. At the call number `at`, by `how`:
   0 nothing, 1 the process is killed before it, 2 half of a write is done (any other call whole) and the process
   is killed, 3 this and all later calls that need room find the disk full, 4 this call meets an input/output error. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static char folder[PATH_MAX];
static long at, seen;
static int how = -1;

void arm(const char *path, long number, int kind) {
    strncpy(folder, path, sizeof folder - 1);
    at = number, seen = 0, how = kind;
}
long counted(void) { return seen; }

static int below(int dir, const char *path) {
    char full[2 * PATH_MAX] = "", link[64];
    if (how < 0) return 0;
    if (!path || path[0] != '/') {
        ssize_t n;
        if (dir == AT_FDCWD) {
            if (!getcwd(full, PATH_MAX)) return 0;
        } else {
            snprintf(link, sizeof link, "/proc/self/fd/%d", dir);
            if ((n = readlink(link, full, PATH_MAX)) < 0) return 0;
            full[n] = 0;
        }
    } else snprintf(full, sizeof full, "%s", path);
    return !strncmp(full, folder, strlen(folder));
}

static void die(void) { kill(getpid(), SIGKILL); for (;;) pause(); }

/* 0: go on; 1: fail with errno set; 2: do it (a write by half), then die */
static int verdict(int needs_room) {
    long now = ++seen;
    if (how == 3 && needs_room && now >= at) { errno = ENOSPC; return 1; }
    if (now != at) return 0;
    if (how == 1) die();
    if (how == 4) { errno = EIO; return 1; }
    return how == 2 ? 2 : 0;
}

#define REAL(type, name, ...) static type (*real)(__VA_ARGS__); \
    if (!real) real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name)
#define CALL(dir, path, room, call) do { \
    int what = below(dir, path) ? verdict(room) : 0; \
    if (what == 1) return -1; \
    if (what == 2) { call; die(); } \
    return call; } while (0)

#define OPEN(name) int name(const char *path, int flags, ...) { \
    REAL(int, name, const char *, int, ...); \
    va_list list; va_start(list, flags); mode_t mode = va_arg(list, mode_t); va_end(list); \
    if (!(flags & (O_CREAT | O_TRUNC))) return real(path, flags, mode); \
    CALL(AT_FDCWD, path, access(path, F_OK) != 0, real(path, flags, mode)); }
OPEN(open)
OPEN(open64)
#define OPENAT(name) int name(int dir, const char *path, int flags, ...) { \
    REAL(int, name, int, const char *, int, ...); \
    va_list list; va_start(list, flags); mode_t mode = va_arg(list, mode_t); va_end(list); \
    if (!(flags & (O_CREAT | O_TRUNC))) return real(dir, path, flags, mode); \
    CALL(dir, path, 1, real(dir, path, flags, mode)); }
OPENAT(openat)
OPENAT(openat64)

ssize_t write(int fd, const void *data, size_t size) {
    REAL(ssize_t, write, int, const void *, size_t);
    int what = fd > 2 && below(fd, NULL) ? verdict(1) : 0;
    if (what == 1) return -1;
    if (what == 2) { if (real(fd, data, size / 2) < 0) die(); die(); }
    return real(fd, data, size);
}
#define PWRITE(name, offset_type) ssize_t name(int fd, const void *data, size_t size, offset_type where) { \
    REAL(ssize_t, name, int, const void *, size_t, offset_type); \
    int what = below(fd, NULL) ? verdict(1) : 0; \
    if (what == 1) return -1; \
    if (what == 2) { if (real(fd, data, size / 2, where) < 0) die(); die(); } \
    return real(fd, data, size, where); }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

int fsync(int fd) { REAL(int, fsync, int); CALL(fd, NULL, 0, real(fd)); }
int fdatasync(int fd) { REAL(int, fdatasync, int); CALL(fd, NULL, 0, real(fd)); }
int ftruncate(int fd, off_t n) { REAL(int, ftruncate, int, off_t); CALL(fd, NULL, n > 0, real(fd, n)); }
int ftruncate64(int fd, off64_t n) { REAL(int, ftruncate64, int, off64_t); CALL(fd, NULL, n > 0, real(fd, n)); }
int unlink(const char *path) { REAL(int, unlink, const char *); CALL(AT_FDCWD, path, 0, real(path)); }
int rmdir(const char *path) { REAL(int, rmdir, const char *); CALL(AT_FDCWD, path, 0, real(path)); }
int unlinkat(int dir, const char *path, int flags) {
    REAL(int, unlinkat, int, const char *, int);
    CALL(dir, path, 0, real(dir, path, flags));
}
int mkdir(const char *path, mode_t mode) {
    REAL(int, mkdir, const char *, mode_t);
    CALL(AT_FDCWD, path, 1, real(path, mode));
}
int mkdirat(int dir, const char *path, mode_t mode) {
    REAL(int, mkdirat, int, const char *, mode_t);
    CALL(dir, path, 1, real(dir, path, mode));
}
int rename(const char *from, const char *to) {
    REAL(int, rename, const char *, const char *);
    CALL(AT_FDCWD, to, 0, real(from, to));
}
int renameat(int a, const char *from, int b, const char *to) {
    REAL(int, renameat, int, const char *, int, const char *);
    CALL(b, to, 0, real(a, from, b, to));
}
int renameat2(int a, const char *from, int b, const char *to, unsigned flags) {
    REAL(int, renameat2, int, const char *, int, const char *, unsigned);
    CALL(b, to, 0, real(a, from, b, to, flags));
}
