/* Constants of the zip format (PKWARE's APPNOTE 6.3), shared by reader and writer. */
#pragma once

enum {
    SIG_LOCAL = 0x04034b50,
    SIG_CENTRAL = 0x02014b50,
    SIG_END = 0x06054b50,
    SIG_END64 = 0x06064b50,
    SIG_LOCATOR = 0x07064b50,
    LOCAL_BYTES = 30,
    CENTRAL_BYTES = 46,
    END_BYTES = 22,
    END64_BYTES = 56,
    LOCATOR_BYTES = 20,
    EXTRA_ZIP64 = 0x0001,
    METHOD_STORED = 0,
    METHOD_DEFLATE = 8
};
#define FULL32 0xffffffffu /* a 32-bit field with this value: the value is in the zip64 record */
