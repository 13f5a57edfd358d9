/* A disk that fails when it is told to: loaded before the C library (LD_PRELOAD).
 *
 * The file that FAILING_DISK names says what fails, on files of which the name holds "map.sqlite":
 *     write 28 3     every write after 3 more that go well fails with error number 28
 *     sync 5 0       every fsync and fdatasync fails with 5 at once
 *     slow 800 0     every fsync and fdatasync takes 800 ms
 * Nothing fails while it is empty. The tests write it.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static char current[64];
static int left;

static int fails(const char *what, int fd)
{
    char link[64], name[512], said[64] = "", kind[16] = "";
    int error = 0, well = 0, kept = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, name, sizeof name - 1);
    if (length < 0) { errno = kept; return 0; }
    name[length] = 0;
    const char *control = getenv("FAILING_DISK");
    if (!control || !strstr(name, "map.sqlite")) { errno = kept; return 0; }
    FILE *file = fopen(control, "r");
    if (file) { if (!fgets(said, sizeof said, file)) said[0] = 0; fclose(file); }
    errno = kept;
    if (sscanf(said, "%15s %d %d", kind, &error, &well) != 3 || strcmp(kind, what)) return 0;
    if (strcmp(said, current)) { strcpy(current, said); left = well; }
    if (left > 0) { left--; return 0; }
    if (!strcmp(kind, "slow")) { usleep(1000 * error); return 0; }
    errno = error;
    return 1;
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
ssize_t pwrite64(int fd, const void *b, size_t n, off64_t at) { return fails("write", fd) ? -1 : NEXT(pwrite64)(fd, b, n, at); }
ssize_t pwrite(int fd, const void *b, size_t n, off_t at) { return fails("write", fd) ? -1 : NEXT(pwrite)(fd, b, n, at); }
ssize_t write(int fd, const void *b, size_t n) { return fails("write", fd) ? -1 : NEXT(write)(fd, b, n); }
int fsync(int fd) { fails("slow", fd); return fails("sync", fd) ? -1 : NEXT(fsync)(fd); }
int fdatasync(int fd) { fails("slow", fd); return fails("sync", fd) ? -1 : NEXT(fdatasync)(fd); }
