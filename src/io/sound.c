#include "io/sound.h"

#include "base/base.h"
#include "io/file.h"

static uint32_t little(const unsigned char *at, int bytes)
{
    uint32_t value = 0;

    for (int i = bytes; i-- > 0;)
        value = value << 8 | at[i];
    return value;
}

static void put_little(unsigned char *at, uint32_t value)
{
    for (int i = 0; i < 4; i++)
        at[i] = (unsigned char)(value >> 8 * i);
}

static bool has_at(const unsigned char *data, size_t size, size_t at, const char *word)
{
    size_t n = strlen(word);

    return at <= size && n <= size - at && memcmp(data + at, word, n) == 0;
}

/* ---- WAV ------------------------------------------------------------------------------------- */

/* Position and layout of the samples in a WAV file. */
struct wav {
    size_t data, n_data; /* offset and size of the samples */
    /* block: bytes of one sample of all channels; rate: samples per second; depth: bits of one
     * sample of one channel */
    uint32_t block, rate, depth;
    uint32_t coding; /* 1: integers; 3: floats; 0xfffe: see the extension of the header */
};

static bool find_samples(const unsigned char *data, size_t size, struct wav *out)
{
    *out = (struct wav){0};
    for (size_t at = 12; at + 8 <= size;) {
        uint32_t n = little(data + at + 4, 4);
        size_t left = size - at - 8;

        if (has_at(data, size, at, "fmt ") && n >= 16 && left >= 16) {
            out->coding = little(data + at + 8, 2);
            out->rate = little(data + at + 12, 4);
            out->block = little(data + at + 20, 2);
            out->depth = little(data + at + 22, 2);
        }
        if (has_at(data, size, at, "data")) {
            out->data = at + 8;
            out->n_data = n < left ? n : left;
            return out->block > 0 && out->rate > 0 && out->n_data >= out->block;
        }
        if (n >= left)
            return false;
        at += 8 + (size_t)n + (n & 1);
    }
    return false;
}

/* ---- Recognising ----------------------------------------------------------------------------- */

static bool is_wav(const unsigned char *data, size_t size)
{
    struct wav wav;

    return has_at(data, size, 0, "RIFF") && has_at(data, size, 8, "WAVE") &&
           find_samples(data, size, &wav);
}

static bool is_flac(const unsigned char *data, size_t size)
{
    return has_at(data, size, 0, "fLaC");
}

/* Returns whether the first packet of an Ogg file begins with the word. */
static bool is_ogg(const unsigned char *data, size_t size, const char *word)
{
    return has_at(data, size, 0, "OggS") && size > 27 &&
           has_at(data, size, 27 + (size_t)data[26], word);
}

static bool is_opus(const unsigned char *data, size_t size)
{
    return is_ogg(data, size, "OpusHead");
}

static bool is_vorbis(const unsigned char *data, size_t size)
{
    return is_ogg(data, size, "\1vorbis");
}

/* Returns whether an MP4 file has a track of this kind, "soun" or "vide". */
static bool has_track(const unsigned char *data, size_t size, const char *kind)
{
    for (size_t at = 4; at + 16 <= size; at++)
        if (data[at] == 'h' && has_at(data, size, at, "hdlr") && has_at(data, size, at + 12, kind))
            return true;
    return false;
}

static bool is_m4a(const unsigned char *data, size_t size)
{
    return has_at(data, size, 4, "ftyp") && has_track(data, size, "soun") &&
           !has_track(data, size, "vide");
}

/* Returns the length in bytes of the ADTS frame of AAC at `d`; 0 if there is none. */
static size_t aac_frame(const unsigned char *d, size_t size)
{
    return size >= 7 && d[0] == 0xff && (d[1] & 0xf6) == 0xf0
               ? (size_t)(d[3] & 3) << 11 | (size_t)d[4] << 3 | d[5] >> 5
               : 0;
}

/* Returns the length in bytes of the MP3 frame (MPEG audio, layer 3) at `d`; 0 if there is none. */
static size_t mp3_frame(const unsigned char *d, size_t size)
{
    static const int kbits[2][15] = {
        {0, 8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160},
        {0, 32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320}};
    static const int rates[4] = {44100, 48000, 32000, 1};
    unsigned version, rate;

    if (size < 4 || d[0] != 0xff || (d[1] & 0xe6) != 0xe2)
        return 0;
    version = d[1] >> 3 & 3; /* 0: MPEG 2.5, 1: reserved, 2: MPEG 2, 3: MPEG 1 */
    rate = d[2] >> 2 & 3;
    if (version == 1 || rate == 3 || d[2] >> 4 == 15 || d[2] >> 4 == 0)
        return 0;
    return (size_t)((version == 3 ? 144000 : 72000) * kbits[version == 3][d[2] >> 4] /
                        (rates[rate] >> (version == 3   ? 0
                                         : version == 2 ? 1
                                                        : 2)) +
                    (d[2] >> 1 & 1));
}

/* Returns whether the file begins, after an optional ID3 tag, with an audio frame that is followed
 * by a second one or by the end of the file. The sync word of a single frame is too short to
 * identify a format. */
static bool has_frames(const unsigned char *data, size_t size,
                       size_t (*frame)(const unsigned char *d, size_t size))
{
    size_t skip = 0, n;

    if (size >= 10 && has_at(data, size, 0, "ID3"))
        skip = 10 + ((size_t)(data[6] & 127) << 21 | (size_t)(data[7] & 127) << 14 |
                     (size_t)(data[8] & 127) << 7 | (data[9] & 127));
    if (skip >= size)
        return false;
    n = frame(data + skip, size - skip);
    return n > 0 && n <= size - skip &&
           (n == size - skip || frame(data + skip + n, size - skip - n) > 0);
}

static bool is_aac(const unsigned char *data, size_t size)
{
    return has_frames(data, size, aac_frame);
}

static bool is_mp3(const unsigned char *data, size_t size)
{
    return has_frames(data, size, mp3_frame);
}

static const struct {
    const char *type, *mime, *ending;
    bool (*is)(const unsigned char *data, size_t size);
} formats[] = {{"wav", "audio/wav", ".wav", is_wav},       {"opus", "audio/ogg", ".opus", is_opus},
               {"vorbis", "audio/ogg", ".ogg", is_vorbis}, {"m4a", "audio/mp4", ".m4a", is_m4a},
               {"aac", "audio/aac", ".aac", is_aac},       {"mp3", "audio/mpeg", ".mp3", is_mp3},
               {"flac", "audio/flac", ".flac", is_flac}};

enum { N_FORMATS = sizeof formats / sizeof *formats };

/* Copies the last component of a path, without its extension. */
static void set_name(struct spin_sound *s, const char *path)
{
    const char *dot;

    path = spin_path_name(path);
    dot = strrchr(path, '.');
    snprintf(s->name, sizeof s->name, "%.*s", dot && dot > path ? (int)(dot - path) : 100, path);
    spin_text_tidy(s->name, false);
}

spin_status spin_sound_set(struct spin_sound *s, const char *name, const void *data, size_t size)
{
    *s = (struct spin_sound){.data = data, .size = size, .gain = 1};
    set_name(s, name);
    if (size == 0 || size > SPIN_SOUND_LIMIT)
        return spin_malformed("the sound '%s' has %zu bytes, expected 1 to %u", s->name, size,
                              SPIN_SOUND_LIMIT);
    for (int i = 0; i < N_FORMATS && !s->type; i++)
        if (formats[i].is(data, size))
            s->type = formats[i].type;
    return s->type ? SPIN_OK
                   : spin_unsupported("the sound '%s' has an unknown format, expected %s", s->name,
                                      spin_sound_formats());
}

const char *spin_sound_formats(void) { return "WAV, MP3, AAC, M4A, Ogg Opus, Ogg Vorbis or FLAC"; }

static int format_of(const struct spin_sound *s)
{
    for (int i = 0; i < N_FORMATS; i++)
        if (strcmp(formats[i].type, s->type) == 0)
            return i;
    return 0;
}

const char *spin_sound_mime(const struct spin_sound *s) { return formats[format_of(s)].mime; }

const char *spin_sound_ending(const struct spin_sound *s) { return formats[format_of(s)].ending; }

/* ---- Durations ------------------------------------------------------------------------------- */

/* Returns the duration of an Opus file in seconds: the position of its last page minus the samples
 * to skip at the beginning, both in units of 1/48000 s. */
static double opus_seconds(const struct spin_sound *s)
{
    size_t head = 27 + (size_t)s->data[26];
    uint32_t skip = head + 12 <= s->size ? little(s->data + head + 10, 2) : 0;

    for (size_t at = s->size; at-- > 0;)
        if (s->data[at] == 'O' && has_at(s->data, s->size, at, "OggS") && at + 14 <= s->size) {
            double end = little(s->data + at + 6, 4) + 4294967296.0 * little(s->data + at + 10, 4);

            return end > skip && end < 1e15 ? (end - skip) / 48000 : 0;
        }
    return 0;
}

double spin_sound_seconds(const struct spin_sound *s)
{
    struct wav wav;

    if (strcmp(s->type, "opus") == 0)
        return opus_seconds(s);
    if (strcmp(s->type, "wav") != 0 || !find_samples(s->data, s->size, &wav))
        return 0;
    return (double)(wav.n_data / wav.block) / wav.rate;
}

/* ---- Aligning -------------------------------------------------------------------------------- */

/* Returns the number n of bytes to drop from the beginning of the samples. If n is negative, -n
 * bytes of silence must be inserted there instead. */
static int64_t bytes_before(const struct spin_sound *s, const struct wav *wav)
{
    double samples = rint(-s->start * wav->rate), most = (double)SPIN_SOUND_LIMIT / wav->block;

    return (int64_t)fmax(-most, fmin(samples, (double)(wav->n_data / wav->block))) *
           (int64_t)wav->block;
}

spin_status spin_sound_align(const struct spin_sound *s, struct spin_sound *out,
                             unsigned char **owned)
{
    struct wav wav;
    int64_t before;
    size_t n, silent;

    *out = *s;
    *owned = NULL;
    if (s->start == 0 || strcmp(s->type, "wav") != 0 || !find_samples(s->data, s->size, &wav))
        return SPIN_OK;
    /* Compressed codings pack several samples into a block, and cannot be cut between samples. */
    if (wav.coding != 1 && wav.coding != 3 && wav.coding != 0xfffe)
        return SPIN_OK;
    before = bytes_before(s, &wav);
    silent = before < 0 ? (size_t)-before : 0;
    n = before < 0 ? wav.n_data + silent : wav.n_data - (size_t)before;
    if (wav.data + n > SPIN_SOUND_LIMIT)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(wav.data + n, 1, (void **)owned));
    memcpy(*owned, s->data, wav.data);
    memset(*owned + wav.data, wav.depth == 8 ? 128 : 0, silent); /* 8-bit samples are unsigned */
    memcpy(*owned + wav.data + silent, s->data + wav.data + (before > 0 ? before : 0), n - silent);
    put_little(*owned + 4, (uint32_t)(wav.data + n - 8));
    put_little(*owned + wav.data - 4, (uint32_t)n);
    out->data = *owned;
    out->size = wav.data + n;
    out->start = 0;
    return SPIN_OK;
}
