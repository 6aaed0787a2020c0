/*
 * The protocol of hierarchies with rates: one attempt of each epoch, and all that was said is said again to who lacks it.
 * docs/model.md says what is modelled and what is not; test_rates.py runs it.
 *
 *   EVERY, OFFSET  spatial takes part in epochs n with n % EVERY == OFFSET (1 and 0; EVERY is at most 2)
 *   DELAY          what spatial predicts counts at the arm so many epochs later (1)
 *   DELAY_WORLD    the same of the arm and the world (0)
 *   GATHER         spatial has in its turn what the arm has given since its last one
 *   CRASHES        how many processes die, at any step (1; at most 2)
 *   DAMAGE         who dies may leave a damaged newest checkpoint; then the run may be stopped, not go wrong
 *   EPOCHS         how many (4; at most 7); the last one is drained
 *   and one macro for each mistake that must be found
 *
 * Each step of a process is one atomic guarded command. A process that dies loses everything but its checkpoint or
 * record, and the new one in its place is there at once; the version of the roster that names it is at hand everywhere
 * and may be taken up at any later time, by the world first. What is written down and what is said next are one step: to
 * die in between is to die afterwards, and what was said is lost.
 */

#ifndef EPOCHS
#define EPOCHS 4
#endif
#ifndef CRASHES
#define CRASHES 1
#endif
#ifndef EVERY
#define EVERY 1
#endif
#ifndef OFFSET
#define OFFSET 0
#endif
#ifndef DELAY
#define DELAY 1
#endif
#ifndef DELAY_WORLD
#define DELAY_WORLD 0
#endif

#include "common.pml"

/* ---- what the rates say ---- */

#define TURN(p, e) ((p) != S || (e) % EVERY == OFFSET)
#define LAST_OF_S(e) ((e) - ((e) + EVERY - OFFSET) % EVERY)
#define POSITIVE(n) IF((n) > 0, n, 0)
#define LAST(p, e) IF((p) == S, POSITIVE(LAST_OF_S(e)), e) /* the last turn up to an epoch */
#ifdef MUT_DELAYS_LEFT_OUT
#define DELAY_OF(p) 0
#else
#define DELAY_OF(p) IF((p) == W, DELAY_WORLD, DELAY)
#endif
/* The epoch whose context counts at p, from the one above it; 0: there is none yet. */
#define IN_FORCE(p, e) LAST((p) + 1, POSITIVE((e) - DELAY_OF(p)))
#ifdef MUT_NO_DRAIN
#define DRAINED(e) false
#else
#define DRAINED(e) ((e) == EPOCHS)
#endif
/* Whether p is told of an epoch, and of which one next. */
#if defined(GATHER) && !defined(MUT_TOLD_OF_TURNS_ALONE)
#define TOLD(p, e) true
#else
#define TOLD(p, e) (TURN(p, e) || DRAINED(e))
#endif
#define NEXT(p, e) ((e) + 1 + !TOLD(p, (e) + 1))
/* Whether somebody hears what p has sensed before that is in a checkpoint of the turn. */
#define IS_HEARD(p, e) IF((p) == S, DRAINED(e), TOLD((p) + 1, e))

/*
 * Sets of epochs are bits. What is under way between two neighbours is a bit for each version and epoch: nothing else
 * tells two messages apart, as all of an epoch say the same (`note_said`), and they come in any order. Epoch 0 is a
 * greeting. What a process that died has said before may come yet. That it may be lost needs no step: who has taken up
 * the next version drops it, and that may always come first.
 */
#define SET(e) (1 << (e))
#define UP_TO(e) ((2 << (e)) - 1)
#define HAS(set, e) ((set) >> (e) & 1)
#define GREETING 1
#define OF(v) (8 * ((v) - 1))
int up[3], down[3]; /* to p: of the one below it, and of the one above it */

#define DONE 0
#define PREDICT 1
#define SAVES_LATE 2
#define ACTS 3 /* the world alone, as the next one */
#define RECORDS_LATE 4

byte version[3] = 1, epoch[3], phase[3];
bit begun[3] = 1;              /* has greeted under its version */
byte state[3], turned[3];      /* after the last turn, and when that was */
byte sensed[3], sensed_in[3];  /* the belief in the middle of an epoch, and of which; 0: its end is in the state */
byte observed[3], told[3];     /* what is in hand, of the one below and of the one above */
byte said_up[3], said_down[3]; /* what neighbours may lack */
byte gathered, r_gathered;     /* by spatial */
byte newest = 1;               /* version of the roster */
byte intended;                 /* the last epoch whose act is on record */

/* Checkpoints; the world's record is as if it was done with the epoch before the one under way. */
byte r_version = 1, r_state[3], r_turned[3], r_sensed[3], r_sensed_in[3], r_up[3], r_down[3], r_intended;

#ifdef DAMAGE
byte o_gathered, o_state[3], o_turned[3], o_sensed[3], o_sensed_in[3], o_up[3], o_down[3], o_intended; /* the other slot */
/* Before which epoch what was said to a neighbour is forgotten, and which of its instances has let that be. */
#define MARK(before, by) ((before) << 2 | (by))
byte up_mark[3], down_mark[3], r_up_mark[3], r_down_mark[3], o_up_mark[3], o_down_mark[3];
byte greeted[12]; /* by process and version: after which epoch it goes on, as it has said */
#define GOES_ON_AFTER(p, ver) greeted[(p) * 4 + (ver)]
byte born[3] = 2; /* the versions with which its processes came */
#define INSTANCE(p, ver) NEWEST_OF(born[p] & UP_TO(ver))
#endif

/* What may still happen, and what was seen. */
byte crashes = CRASHES;
bit finished, refused;
byte commits, acts;
bit was_sensed[24];
byte first_said[24]; /* by process and epoch: the belief of which somebody was told first */
#define BELIEF(p, ep) first_said[(p) * 8 + (ep)]
/* The formal state after an epoch: that of the last turn, to which either half has added one, or who senses anew more. */
#define FORMAL(p, ep) IF((p) == W, ep, IF(LAST(p, ep) == 0, 0, BELIEF(p, LAST(p, ep)) + 1))

hidden byte v, e, i;

/* ---- what is said ---- */

#ifdef MUT_NOT_KEPT
#define KEPT(ep) 0
#else
#define KEPT(ep) SET(ep)
#endif
#define NEWEST_OF(set) /* which epoch; of none, 0 */ \
    (((set) >= 2) + ((set) >= 4) + ((set) >= 8) + ((set) >= 16) + ((set) >= 32) + ((set) >= 64) + ((set) >= 128))
#ifdef MUT_NEWEST_AGAIN
#define AGAIN(said) IF((said) == 0, 0, SET(NEWEST_OF(said)))
#elif defined(MUT_NOTHING_AGAIN)
#define AGAIN(said) 0
#else
#define AGAIN(said) (said)
#endif

/* What is of an older version than its receiver's, or of no use to it, is dropped when it comes: as good as now. */
#ifdef DAMAGE
#define MARKS_DOWN(p, ep) (down_mark[p] < MARK(IN_FORCE((p) - 1, ep), INSTANCE((p) - 1, version[p])))
#define MARKS_UP(p, ep) (up_mark[p] < MARK((ep) + 1, INSTANCE((p) + 1, version[p])))
#else
#define MARKS_DOWN(p, ep) (said_down[p] & SET(IN_FORCE((p) - 1, ep)) - 1)
#define MARKS_UP(p, ep) (said_up[p] & UP_TO(ep))
#endif
#define USELESS_UP(p, ep) ((ep) <= epoch[p] && !MARKS_DOWN(p, ep))
#define USELESS_DOWN(p, ep) \
    ((ep) <= epoch[p] && (HAS(told[p], ep) || (ep) < IN_FORCE(p, epoch[p])) && !(TURN((p) + 1, ep) && MARKS_UP(p, ep)))

inline clean(p) {
    i = 1;
    do
    :: i <= EPOCHS ->
        if
        :: p > W && USELESS_UP(p, i) -> up[p] = up[p] & ~(SET(i) << OF(version[p]))
        :: else
        fi;
        if
        :: p < S && USELESS_DOWN(p, i) -> down[p] = down[p] & ~(SET(i) << OF(version[p]))
        :: else
        fi;
        i++
    :: else -> break
    od;
    i = 0
}

inline to_upper(p, set) {
    if
    :: p < S && version[p] >= version[p + 1] ->
        up[p + 1] = up[p + 1] | (set) << OF(version[p]);
        clean(p + 1)
    :: else
    fi
}

inline to_lower(p, set) {
    if
    :: p > W && version[p] >= version[p - 1] ->
        down[p - 1] = down[p - 1] | (set) << OF(version[p]);
        clean(p - 1)
    :: else
    fi
}

inline take_up(p, new_version) {
    version[p] = new_version;
    up[p] = up[p] >> OF(new_version) << OF(new_version);
    down[p] = down[p] >> OF(new_version) << OF(new_version);
    begun[p] = 0
}

inline greet(p) {
    begun[p] = 1;
#ifdef DAMAGE
    GOES_ON_AFTER(p, version[p]) = turned[p];
#endif
#ifndef MUT_NOBODY_GREETS
    to_upper(p, GREETING);
    to_lower(p, GREETING)
#endif
}

inline note_said(p, belief) { /* all that is ever said of an epoch follows from one belief */
    assert(BELIEF(p, epoch[p]) == 0 || BELIEF(p, epoch[p]) == belief);
    BELIEF(p, epoch[p]) = belief
}

/* ---- checkpoints ---- */

inline save(p) {
    assert(state[p] == FORMAL(p, turned[p]));
#ifdef DAMAGE
    o_gathered = IF(p == S, r_gathered, o_gathered);
    o_state[p] = r_state[p]; o_turned[p] = r_turned[p]; o_sensed[p] = r_sensed[p]; o_sensed_in[p] = r_sensed_in[p];
    o_up[p] = r_up[p]; o_down[p] = r_down[p]; o_up_mark[p] = r_up_mark[p]; o_down_mark[p] = r_down_mark[p];
    r_up_mark[p] = up_mark[p]; r_down_mark[p] = down_mark[p];
#endif
    r_state[p] = state[p]; r_turned[p] = turned[p];
    r_sensed[p] = sensed[p]; r_sensed_in[p] = sensed_in[p];
    if
    :: p == S -> r_gathered = gathered
    :: else
    fi;
#ifndef MUT_SAID_NOT_SAVED
    r_up[p] = said_up[p]; r_down[p] = said_down[p]
#endif
}

inline restore(p) {
    state[p] = r_state[p]; turned[p] = r_turned[p]; epoch[p] = r_turned[p];
    sensed[p] = r_sensed[p]; sensed_in[p] = r_sensed_in[p];
    said_up[p] = r_up[p]; said_down[p] = r_down[p];
#ifdef DAMAGE
    up_mark[p] = r_up_mark[p]; down_mark[p] = r_down_mark[p];
#endif
    observed[p] = 0; told[p] = 0;
    phase[p] = DONE
}

#ifdef DAMAGE
inline damage(p) {
    r_gathered = IF(p == S, o_gathered, r_gathered);
    r_state[p] = o_state[p]; r_turned[p] = o_turned[p]; r_sensed[p] = o_sensed[p]; r_sensed_in[p] = o_sensed_in[p];
    r_up[p] = o_up[p]; r_down[p] = o_down[p]; r_up_mark[p] = o_up_mark[p]; r_down_mark[p] = o_down_mark[p];
    if
    :: p == W -> r_intended = IF(o_intended > r_turned[W], o_intended, r_turned[W] + 1) /* it may have acted */
    :: else
    fi
}
#endif

/* ---- what comes ---- */

/* A neighbour that goes on from an earlier checkpoint than it once did may want what nobody has any more. */
#if defined(DAMAGE) && !defined(MUT_GREETING_NOT_JUDGED)
#define IS_SOUND(mark, from, p) ((mark) >> 2 <= (from) || (mark & 3) == INSTANCE(p, v))
#define IS_SOUND_BELOW(p) IS_SOUND(down_mark[p], IN_FORCE(p - 1, GOES_ON_AFTER(p - 1, v) + 1), p - 1)
#define IS_SOUND_ABOVE(p) IS_SOUND(up_mark[p], GOES_ON_AFTER(p + 1, v) + 1, p + 1)
#else
#define IS_SOUND_BELOW(p) true
#define IS_SOUND_ABOVE(p) true
#endif

#ifdef DAMAGE
#define MARKED(is, before, by) IF(is < MARK(before, INSTANCE(by, v)), MARK(before, INSTANCE(by, v)), is)
#endif

inline refuse(p) {
    printf("refused by %d\n", p);
    refused = 1
}

inline receive_from_below(p) {
    printf("%d gets of %d, version %d: observations %d\n", p, p - 1, v, e);
    if
    :: e == 0 && IS_SOUND_BELOW(p) -> to_lower(p, AGAIN(said_down[p]))
    :: e == 0 && !IS_SOUND_BELOW(p) -> refuse(p)
    :: else ->
#ifdef MUT_FORGETS_IN_FORCE
        said_down[p] = said_down[p] & ~(SET(e) - 1);
#else
        said_down[p] = said_down[p] & ~(SET(IN_FORCE(p - 1, e)) - 1);
#endif
#ifdef DAMAGE
        down_mark[p] = MARKED(down_mark[p], IN_FORCE(p - 1, e), p - 1);
#endif
        if
        :: e > epoch[p] -> observed[p] = observed[p] | SET(e)
        :: else
        fi
    fi
}

inline receive_from_above(p) {
    printf("%d gets of %d, version %d: context %d\n", p, p + 1, v, e);
    if
    :: e == 0 && IS_SOUND_ABOVE(p) -> to_upper(p, AGAIN(said_up[p]))
    :: e == 0 && !IS_SOUND_ABOVE(p) -> refuse(p)
    :: else ->
        if
#ifdef MUT_FORGETS_OBSERVED
        :: true -> said_up[p] = said_up[p] & ~UP_TO(e + 1)
#else
        :: TURN(p + 1, e) ->
#ifdef DAMAGE
            up_mark[p] = MARKED(up_mark[p], e + 1, p + 1);
#endif
            said_up[p] = said_up[p] & ~UP_TO(e)
#endif
        :: else
        fi;
        if
        :: e >= IN_FORCE(p, epoch[p]) -> told[p] = told[p] | SET(e)
        :: else
        fi
    fi
}

inline judge(p, k) { /* which message it is, and whether its version is a new one */
    v = (k) / 8 + 1;
    e = (k) % 8;
    if
    :: v > version[p] -> take_up(p, v)
    :: else
    fi;
    if
    :: !begun[p] -> greet(p)
    :: else
    fi
}

/* ---- what is done with it ---- */

#ifdef DAMAGE
#define VARIES(p) 0 /* or a lost checkpoint shows */
#else
#define VARIES(p) was_sensed[(p) * 8 + epoch[p]]
#endif

inline sense(p) { /* who senses an epoch another time comes to another belief */
    if
#ifndef MUT_SENSES_ANEW
    :: sensed_in[p] == epoch[p] /* that of before counts: its observations may have been heard */
#endif
    :: else ->
        sensed[p] = state[p] + 1 + VARIES(p);
        was_sensed[p * 8 + epoch[p]] = 1;
        if
        :: IS_HEARD(p, epoch[p]) -> sensed_in[p] = epoch[p]; save(p)
        :: else
        fi
    fi
}

inline begin_epoch(p) {
    epoch[p] = NEXT(p, epoch[p]);
    printf("%d begins epoch %d\n", p, epoch[p]);
    assert(state[p] == FORMAL(p, epoch[p] - 1));
    observed[p] = observed[p] & ~UP_TO(epoch[p]);
    gather(p);
    if
    :: TURN(p, epoch[p]) -> sense(p)
    :: else ->
#ifdef MUT_SAVES_BETWEEN
        turned[p] = epoch[p];
        save(p);
        r_gathered = 0
#else
        skip
#endif
    fi;
    phase[p] = IF(TURN(p, epoch[p]) || DRAINED(epoch[p]), PREDICT, DONE);
    say_up(p)
}

inline say_up(p) { /* what the world gives follows from its state */
    if
    :: p != S && TOLD(p + 1, epoch[p]) ->
        if
        :: p == A -> note_said(p, sensed[p])
        :: else
        fi;
        said_up[p] = said_up[p] | KEPT(epoch[p]);
        to_upper(p, SET(epoch[p]))
    :: else
    fi
}

inline gather(p) {
#ifdef GATHER
    if
    :: p == S ->
#ifdef MUT_GATHERED_FORGOTTEN
        gathered = 0;
#endif
        gathered = gathered | SET(epoch[S]);
        if
        :: TURN(S, epoch[S]) ->
            assert(gathered == (UP_TO(epoch[S]) & ~UP_TO(LAST(S, epoch[S] - 1))));
            gathered = 0
        :: else
        fi
    :: else
    fi
#else
    skip
#endif
}

#ifdef MUT_NEWEST_COUNTS
#define COUNTS(p) IF(told[p] != 0, NEWEST_OF(told[p]), IN_FORCE(p, epoch[p]))
#else
#define COUNTS(p) IN_FORCE(p, epoch[p])
#endif
#define MAY_PREDICT(p) \
    (p == S || (COUNTS(p) == 0 || HAS(told[p], COUNTS(p))) && (!DRAINED(epoch[p]) || HAS(told[p], epoch[p])))

inline check_context(p) { /* the last turn of the one above that counts by now, by its definition; it is written down */
    e = COUNTS(p);
    v = POSITIVE(epoch[p] - IF(p == W, DELAY_WORLD, DELAY));
    do
    :: v > 0 && p == A && v % EVERY != OFFSET -> v--
    :: else -> break
    od;
    assert(e == v);
#ifndef DAMAGE
    assert(r_turned[p + 1] >= e)
#endif
}

inline predict(p) {
    if
    :: p != S -> check_context(p); told[p] = told[p] & ~(SET(IN_FORCE(p, epoch[p])) - 1)
    :: else
    fi;
    if
    :: p != W -> note_said(p, sensed[p])
    :: else
    fi;
    printf("%d predicts in epoch %d\n", p, epoch[p])
}

inline finish_turn(p) {
    state[p] = sensed[p] + 1;
    save_and_say_down(p)
}

inline finish_other(p) { /* of a drained epoch all are told that it is done */
#ifdef MUT_NO_EMPTY_CONTEXT
    phase[p] = DONE
#else
    save_and_say_down(p)
#endif
}

inline save_and_say_down(p) {
    turned[p] = epoch[p]; sensed_in[p] = 0;
    phase[p] = DONE;
#ifdef MUT_SAVED_WITHOUT_NEXT
    save(p);
#endif
    said_down[p] = said_down[p] | KEPT(epoch[p]);
#ifdef MUT_CHECKPOINT_LATE
    phase[p] = SAVES_LATE;
#elif !defined(MUT_SAVED_WITHOUT_NEXT)
    save(p);
#endif
    to_lower(p, SET(epoch[p]))
}

/* Who can go on by itself does, before it hears of anything else. */
#define CAN_BEGIN(p) (phase[p] == DONE && HAS(observed[p], NEXT(p, epoch[p])))
#define CAN_PREDICT(p) (phase[p] == PREDICT && TURN(p, epoch[p]) && MAY_PREDICT(p))
#define IDLE(p) \
    (phase[p] <= PREDICT && !CAN_BEGIN(p) && !CAN_PREDICT(p) && !(phase[p] == PREDICT && !TURN(p, epoch[p])))

proctype node(byte p) {
    byte k;
    {
    do
    :: atomic { up[p] != 0 && IDLE(p) ->
        do
        :: HAS(up[p], k) -> break
        :: up[p] >> k > 1 -> k++
        od;
        d_step { up[p] = up[p] & ~SET(k); judge(p, k); receive_from_below(p); clean(p); k = 0 } }
    :: atomic { down[p] != 0 && IDLE(p) ->
        do
        :: HAS(down[p], k) -> break
        :: down[p] >> k > 1 -> k++
        od;
        d_step { down[p] = down[p] & ~SET(k); judge(p, k); receive_from_above(p); clean(p); k = 0 } }
    :: d_step { CAN_BEGIN(p) -> begin_epoch(p); clean(p) }
    :: d_step { CAN_PREDICT(p) -> predict(p); finish_turn(p); clean(p) }
    :: d_step { phase[p] == PREDICT && !TURN(p, epoch[p]) -> finish_other(p); clean(p) }
#ifdef MUT_CHECKPOINT_LATE
    :: d_step { phase[p] == SAVES_LATE -> save(p); phase[p] = DONE }
#endif
    od
    } unless { finished || refused }
}

/* ---- the world, and the owner beside it ---- */

inline record() { /* what it is done with, what it has said, its acts and its version */
    if
    :: turned[W] > commits ->
        printf("world commits epoch %d\n", turned[W]);
        assert(commits == turned[W] - 1);
        commits = turned[W];
        assert(acts == commits || crashes < CRASHES)
    :: else
    fi;
    save(W);
    r_intended = intended; r_version = version[W]
}

inline world_begins() {
#ifndef MUT_RECORD_LATE
    record();
#endif
    epoch[W]++;
    printf("world begins epoch %d under version %d\n", epoch[W], version[W]);
    phase[W] = PREDICT;
#ifdef MUT_RECORD_LATE
    phase[W] = RECORDS_LATE;
#endif
    if
    :: !begun[W] -> greet(W)
    :: else
    fi;
    say_up(W);
    clean(W)
}

inline intend() { /* nobody knows of an act that was intended whether it was done: it is not done again */
    if
#ifdef MUT_ACTS_AGAIN
    :: true ->
#else
    :: epoch[W] > intended ->
#endif
        intended = epoch[W];
        record();
        phase[W] = ACTS
    :: else -> finish_acting()
    fi
}

inline finish_acting() {
    state[W]++; turned[W] = epoch[W];
    phase[W] = DONE
}

inline check_end() {
    i = A;
    do
    :: i <= S ->
#ifndef DAMAGE
        assert(r_turned[i] == EPOCHS && r_state[i] == FORMAL(i, EPOCHS));
#endif
        assert(epoch[i] < EPOCHS || state[i] == FORMAL(i, EPOCHS));
        i++
    :: else -> break
    od
}

proctype world() {
    byte k;
    {
    do
    :: atomic { begun[W] && phase[W] <= PREDICT && !CAN_PREDICT(W) && down[W] != 0 ->
        do
        :: HAS(down[W], k) -> break
        :: down[W] >> k > 1 -> k++
        od;
        d_step { down[W] = down[W] & ~SET(k); judge(W, k); receive_from_above(W); clean(W); k = 0 } }

    /* a new version is taken up with an epoch, or in the midst of one */
    :: d_step { phase[W] == DONE && begun[W] && epoch[W] < EPOCHS -> world_begins() }
    :: d_step { phase[W] == DONE && version[W] < newest && epoch[W] < EPOCHS -> take_up(W, newest); world_begins() }
    :: d_step { phase[W] == PREDICT && version[W] < newest -> take_up(W, newest); record(); greet(W); clean(W) }
#ifdef MUT_RECORD_LATE
    :: d_step { phase[W] == RECORDS_LATE -> record(); phase[W] = PREDICT }
#endif
    :: d_step { CAN_PREDICT(W) -> predict(W); intend(); clean(W) }
    :: d_step { phase[W] == ACTS -> assert(acts < epoch[W]); acts = epoch[W]; finish_acting(); clean(W) }
    :: d_step { phase[W] == DONE && epoch[W] == EPOCHS && begun[W] -> record(); check_end(); finished = 1 }
    od
    } unless { finished || refused }
}

/* ---- what goes wrong ---- */

inline die(p, damaged) {
    printf("%d dies, damaged: %d\n", p, damaged);
    crashes--;
    newest++;
    assert(newest < 4); /* the model's own limit */
#ifdef DAMAGE
    born[p] = born[p] | SET(newest);
    if
    :: damaged -> damage(p)
    :: else
    fi;
#endif
    restore(p);
    if
    :: p == W -> intended = r_intended; take_up(W, r_version)
    :: else -> take_up(p, newest)
    fi;
    if
    :: p == S -> gathered = r_gathered
    :: else
    fi
}

proctype fate() {
    {
    do
    :: crashes == 0 -> break
    :: d_step { crashes > 0 -> die(W, false) }
    :: d_step { crashes > 0 -> die(A, false) }
    :: d_step { crashes > 0 -> die(S, false) }
#ifdef DAMAGE
    :: d_step { crashes > 0 -> die(W, true) }
    :: d_step { crashes > 0 -> die(A, true) }
    :: d_step { crashes > 0 -> die(S, true) }
#endif
    od
    } unless { finished || refused }
}

init {
    atomic { run world(); run node(A); run node(S); run fate() }
}

ltl ends { <> (finished || refused) }
