/* Parameters that survive power off; layout and argument in parameter_store.h. */
#include "firmware/parameter_store.h"

#include "firmware/frame.h"

#define BLANK_WORD 0xFFFFU
#define OPEN_MARKER 0U
#define START_CALLS_MAX 4000

/* Words of a bank. */
enum { MARKER = 0, SEQUENCE, TABLE, COUNT, VALUES };
#define CRC_WORD(count) ((u16)(VALUES + (count)))
#define LAST_WORD CRC_WORD(PARAMETER_COUNT)

/* What a bank was found to hold, the more worth keeping the later. */
enum { FOUND_NOTHING_WHOLE = 0, FOUND_BLANK, FOUND_OTHER_TABLE, FOUND_OURS };

/* Each has a function below that handles one word. */
enum { RESTING = 0, CHECKING, APPLYING, OPENING, WRITING, VERIFYING, CLOSING, CONFIRMING };

/* All parameters and five words more fit into a bank. */
typedef int parameter_store_bank_is_large_enough
    [(PARAMETER_COUNT + VALUES < PARAMETER_STORE_BANK_WORDS) * 2 - 1];

static u16 address(const parameter_store *store) {
    return (u16)(store->bank * PARAMETER_STORE_BANK_WORDS + store->at);
}

static u16 read_word(const parameter_store *store) {
    return hal_store_read(address(store));
}

static void begin(parameter_store *store, u16 step, u16 bank, u16 at) {
    store->step = step;
    store->bank = bank;
    store->at = at;
    store->crc = FRAME_CRC_START;
}

static void end(parameter_store *store, parameter_store_status status) {
    store->step = RESTING;
    store->at = MARKER; /* never beyond a bank, whatever the step */
    store->status = status;
}

/* ---- Loading ---- */

/* 1 when bank a holds what is worth more than what b holds, or the same and newer. */
static u16 is_newer(const parameter_store *store, u16 a, u16 b) {
    if (store->found[a] != store->found[b])
        return store->found[a] > store->found[b];
    return (u16)(store->sequence[a] - store->sequence[b]) < 0x8000U;
}

static parameter_store_status status_of_banks(const parameter_store *store) {
    const u16 other = store->found[1 - store->current];
    switch (store->found[store->current]) {
        case FOUND_OURS:
            return other == FOUND_NOTHING_WHOLE ? PARAMETER_STORE_LOADED_OLDER
                                                : PARAMETER_STORE_LOADED;
        case FOUND_OTHER_TABLE:
            return PARAMETER_STORE_OTHER_TABLE;
        case FOUND_BLANK:
            return other == FOUND_BLANK ? PARAMETER_STORE_BLANK : PARAMETER_STORE_CORRUPT;
        default:
            return PARAMETER_STORE_CORRUPT;
    }
}

static void bank_checked(parameter_store *store, u16 found, parameters *p) {
    store->found[store->bank] = found;
    if (store->bank == 0) {
        begin(store, CHECKING, 1, MARKER);
        return;
    }
    store->current = is_newer(store, 0, 1) ? 0 : 1;
    if (store->found[store->current] == FOUND_OURS) {
        begin(store, APPLYING, store->current, VALUES);
    } else {
        parameters_set_defaults(p);
        end(store, status_of_banks(store));
    }
}

/* 1 when the word may stand where it does. */
static u16 plausible(parameter_store *store, u16 word) {
    const u16 id = (u16)(store->at - VALUES);
    parameter_info info;
    switch (store->at) {
        case MARKER:
            return word == PARAMETER_STORE_WHOLE;
        case SEQUENCE:
            store->sequence[store->bank] = word;
            return 1;
        case TABLE:
            store->found[store->bank] = word == store->table ? FOUND_OURS : FOUND_OTHER_TABLE;
            return 1;
        case COUNT:
            if (word >= PARAMETER_STORE_BANK_WORDS - VALUES)
                return 0;
            store->count = word;
            return store->found[store->bank] != FOUND_OURS || word == PARAMETER_COUNT;
        default:
            break;
    }
    if (store->found[store->bank] != FOUND_OURS)
        return 1;
    if (id >= PARAMETER_COUNT)
        return 0;
    parameters_describe(id, &info);
    return (i16)word >= info.minimum && (i16)word <= info.maximum;
}

static void check_word(parameter_store *store, parameters *p) {
    const u16 word = read_word(store);
    if (store->at == MARKER && word == BLANK_WORD) {
        bank_checked(store, FOUND_BLANK, p);
    } else if (store->at > COUNT && store->at >= CRC_WORD(store->count)) {
        bank_checked(store,
                     word == store->crc ? store->found[store->bank] : (u16)FOUND_NOTHING_WHOLE, p);
    } else if (!plausible(store, word)) {
        bank_checked(store, FOUND_NOTHING_WHOLE, p);
    } else {
        if (store->at != MARKER)
            store->crc = frame_crc_u16(store->crc, word);
        store->at++;
    }
}

static void apply_word(parameter_store *store, parameters *p) {
    if (parameters_set(p, (u16)(store->at - VALUES), (i16)read_word(store)) != PARAMETERS_OK) {
        parameters_set_defaults(p); /* it has changed since it was checked */
        end(store, PARAMETER_STORE_CORRUPT);
        return;
    }
    store->at++;
    if (store->at >= LAST_WORD)
        end(store, status_of_banks(store));
}

void parameter_store_load(parameter_store *store) {
    store->status = PARAMETER_STORE_LOADING;
    begin(store, CHECKING, 0, MARKER);
}

void parameter_store_start(parameter_store *store, parameters *p) {
    u16 calls;
    store->table = parameters_fingerprint();
    store->sequence[0] = 0;
    store->sequence[1] = 0;
    store->found[0] = FOUND_NOTHING_WHOLE;
    store->found[1] = FOUND_NOTHING_WHOLE;
    store->count = 0;
    store->current = 0;
    parameters_set_defaults(p);
    parameter_store_load(store);
    for (calls = 0; calls < START_CALLS_MAX && store->step != RESTING; calls++)
        parameter_store_tick(store, p);
    if (store->step != RESTING) { /* a memory that is busy for ever */
        parameters_set_defaults(p);
        end(store, PARAMETER_STORE_CORRUPT);
    }
}

/* ---- Saving ---- */

/* The word that the set being saved has at store->at; from word 1 on, in order. */
static u16 word_to_save(parameter_store *store, const parameters *p) {
    i32 value = 0;
    u16 word;
    switch (store->at) {
        case SEQUENCE:
            word = (u16)(store->sequence[store->current] + 1U);
            break;
        case TABLE:
            word = store->table;
            break;
        case COUNT:
            word = PARAMETER_COUNT;
            break;
        case LAST_WORD:
            return store->crc;
        default:
            parameters_get(p, (u16)(store->at - VALUES), &value);
            word = (u16)value;
            break;
    }
    store->crc = frame_crc_u16(store->crc, word);
    return word;
}

/* A marker that is not whole stays: while it is written it may read as whole, over a half set. */
static void open_bank(parameter_store *store) {
    if (read_word(store) == PARAMETER_STORE_WHOLE)
        hal_store_write(address(store), OPEN_MARKER);
    begin(store, WRITING, store->bank, SEQUENCE);
}

static void write_word(parameter_store *store, const parameters *p) {
    const u16 word = word_to_save(store, p);
    hal_store_write(address(store), word);
    store->at++;
    if (store->at > LAST_WORD)
        begin(store, VERIFYING, store->bank, SEQUENCE);
}

static void verify_word(parameter_store *store, const parameters *p) {
    if (read_word(store) != word_to_save(store, p)) {
        end(store, PARAMETER_STORE_SAVE_FAILED);
        return;
    }
    store->at++;
    if (store->at > LAST_WORD)
        begin(store, CLOSING, store->bank, MARKER);
}

static void confirm(parameter_store *store) {
    if (read_word(store) != PARAMETER_STORE_WHOLE) {
        end(store, PARAMETER_STORE_SAVE_FAILED);
        return;
    }
    store->sequence[store->bank] = (u16)(store->sequence[store->current] + 1U);
    store->current = store->bank;
    end(store, PARAMETER_STORE_SAVED);
}

void parameter_store_save(parameter_store *store) {
    store->status = PARAMETER_STORE_SAVING;
    begin(store, OPENING, (u16)(1 - store->current), MARKER);
}

/* ---- Both ---- */

u16 parameter_store_at_work(const parameter_store *store) {
    return store->step != RESTING;
}

void parameter_store_tick(parameter_store *store, parameters *p) {
    if (store->step == RESTING || hal_store_busy())
        return;
    switch (store->step) {
        case CHECKING:
            check_word(store, p);
            break;
        case APPLYING:
            apply_word(store, p);
            break;
        case OPENING:
            open_bank(store);
            break;
        case WRITING:
            write_word(store, p);
            break;
        case VERIFYING:
            verify_word(store, p);
            break;
        case CLOSING:
            hal_store_write(address(store), PARAMETER_STORE_WHOLE);
            store->step = CONFIRMING;
            break;
        default:
            confirm(store);
            break;
    }
}
