/* Two 64-bit numbers in the file $FAULTY say how often in a thousand writes below $FAULTY_ROOT fail or are short, and by
   how many seconds the clock on the wall is wrong. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

static volatile int64_t *says;
static __thread unsigned state;

__attribute__((constructor)) static void begin(void) {
    const char *name = getenv("FAULTY");
    int file = name ? open(name, O_RDONLY) : -1;
    void *map = file < 0 ? MAP_FAILED : mmap(NULL, 16, PROT_READ, MAP_SHARED, file, 0);
    if (map != MAP_FAILED) says = map;
    if (file >= 0) close(file);
}

static int unlucky(int file) {
    if (!says || !says[0]) return 0;
    char link[64], path[4096];
    const char *root = getenv("FAULTY_ROOT");
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path);
    if (!root || length < (ssize_t)strlen(root) || strncmp(path, root, strlen(root))) return 0;
    if (!state) state = getpid() * 2654435761u;
    return rand_r(&state) % 1000 < says[0];
}

static int fails(void) {
    int kind = rand_r(&state) % 3;
    errno = kind == 1 ? ENOSPC : EIO;
    return kind;
}

ssize_t write(int file, const void *bytes, size_t count) {
    ssize_t (*real)(int, const void *, size_t) = dlsym(RTLD_NEXT, "write");
    if (!unlucky(file)) return real(file, bytes, count);
    return fails() || count < 2 ? -1 : real(file, bytes, count / 2);
}

ssize_t writev(int file, const struct iovec *parts, int count) {
    ssize_t (*real)(int, const struct iovec *, int) = dlsym(RTLD_NEXT, "writev");
    if (!unlucky(file)) return real(file, parts, count);
    return fails() || count < 2 ? -1 : real(file, parts, 1);
}

int fsync(int file) {
    int (*real)(int) = dlsym(RTLD_NEXT, "fsync");
    if (!unlucky(file)) return real(file);
    fails();
    return -1;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int (*real)(clockid_t, struct timespec *) = dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(clock, now);
    if (!failed && says && clock == CLOCK_REALTIME) now->tv_sec += says[1];
    return failed;
}
