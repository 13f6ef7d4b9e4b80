/* Stands between a process and its host.  The file that HOST_FAULTS names holds two numbers: the
   nanoseconds to add to the clock, and how many of 10,000 datagrams to drop. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile int64_t none[2];
static volatile int64_t *faults = none;

__attribute__((constructor)) static void start(void) {
  int file = open(getenv("HOST_FAULTS"), O_RDONLY);
  void *at = mmap(0, sizeof none, PROT_READ, MAP_SHARED, file, 0);
  if (at != MAP_FAILED) faults = at;
  close(file);
}

int clock_gettime(clockid_t id, struct timespec *at) {
  long done = syscall(SYS_clock_gettime, id, at);
  if (!done && id == CLOCK_REALTIME) {
    int64_t now = at->tv_sec * 1000000000LL + at->tv_nsec + faults[0];
    at->tv_sec = now / 1000000000LL;
    at->tv_nsec = now % 1000000000LL;
  }
  return done;
}

int gettimeofday(struct timeval *at, void *zone) {
  struct timespec now;
  int done = clock_gettime(CLOCK_REALTIME, &now);
  (void)zone;
  at->tv_sec = now.tv_sec;
  at->tv_usec = now.tv_nsec / 1000;
  return done;
}

time_t time(time_t *at) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (at) *at = now.tv_sec;
  return now.tv_sec;
}

/* The kernel does not know the clock that was set, so that deadlines are converted to its time.
   A deadline below some thirty years belongs to the steady clock and stays as it is. */
static struct timespec true_time(const struct timespec *until) {
  struct timespec at = *until;
  if (at.tv_sec > 1000000000) {
    int64_t then = at.tv_sec * 1000000000LL + at.tv_nsec - faults[0];
    at.tv_sec = then / 1000000000LL;
    at.tv_nsec = then % 1000000000LL;
  }
  return at;
}

int pthread_cond_timedwait(
    pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *until) {
  static int (*wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
  if (!wait) wait = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
  struct timespec at = true_time(until);
  return wait(condition, mutex, &at);
}

int pthread_cond_clockwait(
    pthread_cond_t *condition, pthread_mutex_t *mutex, clockid_t id, const struct timespec *until) {
  static int (*wait)(pthread_cond_t *, pthread_mutex_t *, clockid_t, const struct timespec *);
  if (!wait) wait = dlsym(RTLD_NEXT, "pthread_cond_clockwait");
  struct timespec at = true_time(until);
  return wait(condition, mutex, id, &at);
}

int sem_timedwait(sem_t *semaphore, const struct timespec *until) {
  static int (*wait)(sem_t *, const struct timespec *);
  if (!wait) wait = dlsym(RTLD_NEXT, "sem_timedwait");
  struct timespec at = true_time(until);
  return wait(semaphore, &at);
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *until) {
  static int (*lock)(pthread_mutex_t *, const struct timespec *);
  if (!lock) lock = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
  struct timespec at = true_time(until);
  return lock(mutex, &at);
}

static __thread unsigned int seed;

static int lost(int socket) {
  int kind = 0;
  socklen_t size = sizeof kind;
  if (!seed) seed = syscall(SYS_gettid);
  return faults[1] && rand_r(&seed) % 10000 < faults[1] && !getsockopt(socket, SOL_SOCKET, SO_TYPE, &kind, &size) && kind == SOCK_DGRAM;
}

ssize_t sendmsg(int socket, const struct msghdr *message, int flags) {
  if (!lost(socket)) return syscall(SYS_sendmsg, socket, message, flags);
  ssize_t size = 0;
  for (size_t n = 0; n < message->msg_iovlen; n++) size += message->msg_iov[n].iov_len;
  return size;
}

ssize_t sendto(
    int socket, const void *data, size_t size, int flags, const struct sockaddr *to,
    socklen_t length) {
  if (lost(socket)) return size;
  return syscall(SYS_sendto, socket, data, size, flags, to, length);
}
