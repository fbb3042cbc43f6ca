/* SPDX-FileCopyrightText: 2026 valve_control developers */
/* SPDX-License-Identifier: Apache-2.0 */
/* Reference firmware of a card on a serial line: samples the LVDT by its own clock, takes voltages.

   The board gives five functions; sample_timer() is called once per sample period, from a timer of the board,
   received() with each byte of the serial line, neither of them while the other runs. */

#include <stdint.h>

extern int16_t read_lvdt(int *sound);       /* counts, 32767 for full scale; *sound: 0 if it is not valid */
extern void write_voltage(int16_t counts);  /* to the amplifier */
extern void switch_output(int on);          /* enable line of the amplifier */
extern void send_bytes(const uint8_t *data, int size);
extern uint32_t milliseconds(void);         /* since the start */

enum { SIZE = 8, ON = 1, SILENCE = 2, SENSOR = 4, WATCHDOG = 100 /* ms */ };

static uint8_t frame[SIZE];
static int filled = 0, asked = 0, silent = 1;
static int16_t rest = 0; /* counts of the last frame that switched off: those of 0 V */
static uint16_t counter = 0;
static uint32_t heard = 0;

static uint16_t crc16(const uint8_t *data, int size) {
    uint16_t crc = 0xFFFF;
    for (int i = 0; i < size; i++) {
        crc ^= (uint16_t)(data[i] << 8);
        for (int bit = 0; bit < 8; bit++) crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
    }
    return crc;
}

static void output(int on, int16_t counts) {
    asked = on;
    if (!on) rest = counts;
    write_voltage(counts);
    switch_output(on);
}

static void drop_byte(void) { /* and all that are not the beginning of a frame */
    do {
        filled--;
        for (int i = 0; i < filled; i++) frame[i] = frame[i + 1];
    } while (filled && frame[0] != 0x5A);
}

void received(uint8_t byte) {
    frame[filled++] = byte;
    if (frame[0] != 0x5A) drop_byte();
    if (filled < SIZE) return;
    if (crc16(frame, 6) == (uint16_t)(frame[6] | frame[7] << 8)) {
        heard = milliseconds();
        silent = 0;
        output(frame[1] & ON, (int16_t)(frame[4] | frame[5] << 8));
        filled = 0;
    } else {
        drop_byte(); /* the next beginning may be within the damaged frame */
    }
}

void sample_timer(void) {
    int sound = 1;
    int16_t counts = read_lvdt(&sound);
    if (!silent && milliseconds() - heard >= WATCHDOG) {
        silent = 1;
        output(0, rest);
    }
    uint8_t data[SIZE] = {0xA5, (uint8_t)((asked ? ON : 0) | (silent ? SILENCE : 0) | (sound ? 0 : SENSOR)),
                          (uint8_t)counter, (uint8_t)(counter >> 8), (uint8_t)counts, (uint8_t)(counts >> 8)};
    uint16_t crc = crc16(data, 6);
    data[6] = (uint8_t)crc;
    data[7] = (uint8_t)(crc >> 8);
    send_bytes(data, SIZE);
    counter++;
}
