/* Frames between a plant and its controller on a serial line, as masking speaks them; C99 and C++, no heap.
 *
 * A frame, little-endian: "MSKG", version 1, kind, two zeros, session (8), index (8), time of sending in ns (8), count (4),
 * payload (count doubles, or count bytes of text), CRC-32 of all before. On the line it is written without zeros, by
 * consistent overhead byte stuffing, and a zero follows.
 */

#ifndef FRAMES_H
#define FRAMES_H

#include <stdint.h>
#include <string.h>

#if __SIZEOF_DOUBLE__ != 8 || __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "frames hold doubles of 8 bytes, little-endian: take a board with an ARM or an Xtensa processor"
#endif

#define FRAMES_PAYLOAD 512u /* bytes; a longer frame is dropped */
#define FRAMES_HEAD 36u
#define FRAMES_LARGEST (FRAMES_HEAD + FRAMES_PAYLOAD + 4u)
#define FRAMES_STREAM (FRAMES_LARGEST + FRAMES_LARGEST / 254u + 2u)

enum { FRAMES_HELLO = 1, FRAMES_ACCEPT, FRAMES_REFUSE, FRAMES_STOP, FRAMES_START, FRAMES_BYE, FRAMES_SENSORS, FRAMES_COMMAND };

typedef struct {
    uint8_t bytes[FRAMES_STREAM];
    uint32_t size; /* bytes that came since the last zero */
    int kind;      /* of the frame that is complete */
    uint64_t session, index;
    uint32_t count;
} frames_reader;

static uint32_t frames_check(const uint8_t *bytes, uint32_t size)
{
    uint32_t check = 0xFFFFFFFFu;
    while (size-- > 0) {
        check ^= *bytes++;
        for (int bit = 0; bit < 8; bit++) {
            check = (check >> 1) ^ (0xEDB88320u & (0u - (check & 1u)));
        }
    }
    return ~check;
}

static int frames_sound(frames_reader *reader, uint32_t size)
{
    uint32_t check, count;
    uint8_t *bytes = reader->bytes;
    if (size < FRAMES_HEAD + 4u || memcmp(bytes, "MSKG\1", 5) != 0) {
        return 0;
    }
    memcpy(&check, bytes + size - 4u, 4);
    memcpy(&count, bytes + 32, 4);
    if (check != frames_check(bytes, size - 4u) || count > FRAMES_PAYLOAD) {
        return 0;
    }
    if (size - FRAMES_HEAD - 4u != (bytes[5] < FRAMES_SENSORS ? count : 8u * count)) {
        return 0;
    }
    reader->kind = bytes[5];
    reader->count = count;
    memcpy(&reader->session, bytes + 8, 8);
    memcpy(&reader->index, bytes + 16, 8);
    return 1;
}

/* Take a byte; return 1 where it completes a sound frame, which stays until the next byte. */
static int frames_feed(frames_reader *reader, uint8_t byte)
{
    if (byte != 0u) {
        if (reader->size < FRAMES_STREAM) {
            reader->bytes[reader->size] = byte;
        }
        reader->size++; /* beyond the end it only counts, so that the frame is dropped */
        return 0;
    }
    uint32_t size = reader->size, to = 0, from = 0;
    reader->size = 0;
    if (size == 0 || size > FRAMES_STREAM) {
        return 0;
    }
    while (from < size) {
        uint32_t length = reader->bytes[from++];
        for (uint32_t i = 1; i < length && from < size; i++) {
            reader->bytes[to++] = reader->bytes[from++];
        }
        if (length < 255u && from < size) {
            reader->bytes[to++] = 0;
        }
    }
    return frames_sound(reader, to);
}

static double frames_value(const frames_reader *reader, uint32_t i)
{
    double value;
    memcpy(&value, reader->bytes + FRAMES_HEAD + 8u * i, 8);
    return value;
}

/* Write a frame for the line, of at most FRAMES_STREAM bytes; return how many. */
static uint32_t frames_write(uint8_t *line, int kind, uint64_t session, uint64_t index, const void *payload, uint32_t count)
{
    static uint8_t frame[FRAMES_LARGEST];
    uint32_t size = FRAMES_HEAD + (kind < FRAMES_SENSORS ? count : 8u * count), to = 1, code = 0;
    memset(frame, 0, FRAMES_HEAD); /* the time stays zero: it only serves records */
    memcpy(frame, "MSKG\1", 5);
    frame[5] = (uint8_t)kind;
    memcpy(frame + 8, &session, 8);
    memcpy(frame + 16, &index, 8);
    memcpy(frame + 32, &count, 4);
    if (size > FRAMES_HEAD) {
        memcpy(frame + FRAMES_HEAD, payload, size - FRAMES_HEAD);
    }
    uint32_t check = frames_check(frame, size);
    memcpy(frame + size, &check, 4);
    size += 4u;
    line[0] = 1;
    for (uint32_t from = 0; from < size; from++) {
        if (frame[from] != 0) {
            line[to++] = frame[from];
            line[code]++;
        }
        if (frame[from] == 0 || line[code] == 255u) {
            if (frame[from] != 0 && from + 1u == size) {
                break;
            }
            code = to;
            line[to++] = 1;
        }
    }
    line[to++] = 0;
    return to;
}

#endif
