/* K: zip gzip checksum */
#include <string.h>
#include <zlib.h>

#include "io/crc.h"
#include "tests/tap.h"

enum { ROOM = 4096 };

TAP_MAIN
{
    static unsigned char bytes[ROOM + 64];
    uint32_t seed = 1, whole, pieces = 0;
    int wrong = 0;

    ok(spin_crc32(0, "123456789", 9) == 0xcbf43926, "the check value of CRC-32");
    ok(spin_crc32(0, NULL, 0) == 0 && spin_crc32(77, NULL, 0) == 77, "nothing adds nothing");
    for (size_t i = 0; i < sizeof bytes; i++) {
        seed = seed * 1664525u + 1013904223u;
        bytes[i] = (unsigned char)(seed >> 24);
    }
    for (size_t n = 0; n <= ROOM; n += n < 700 ? 1 : 61)
        for (size_t from = 0; from < 20; from += 3)
            wrong += spin_crc32(seed, bytes + from, n) != crc32_z(seed, bytes + from, n);
    ok(wrong == 0, "that of zlib, at every length and place (%d differ)", wrong);
    whole = spin_crc32(0, bytes, ROOM);
    for (size_t at = 0; at < ROOM; at += 512)
        pieces = spin_crc32(pieces, bytes + at, 512);
    ok(pieces == whole, "the same in pieces");
    bytes[ROOM / 2] ^= 1;
    ok(spin_crc32(0, bytes, ROOM) != whole, "and not when a bit is turned over");
    memset(bytes, 0, sizeof bytes);
    ok(spin_crc32(0, bytes, ROOM) == crc32_z(0, bytes, ROOM), "of zeros");
}
