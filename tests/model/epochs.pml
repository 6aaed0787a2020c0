/*
 * The protocol of docs/epochs.md: epochs as transactions, the roster in two phases, recovery.
 * docs/model.md says what is modelled and what is not; test_epochs.py runs it.
 *
 *   ATTACH    begins with the world and the arm; `spatial` asks to be attached above the arm
 *   REPLACE   the world, the arm, spatial; another process asks to take the arm's place
 *   neither   the world, the arm, spatial
 *   DIAMOND   spatial stands above the world, too
 *   CRASHES   how many processes die, at any step (1)
 *   REDOS     how often the world does an epoch again, under the same roster (0)
 *   DAMAGE    who dies may leave a damaged newest checkpoint; then the run may be stopped, not go wrong
 *   EPOCHS    how many (3)
 *   and one macro for each mistake that must be found
 *
 * Each step of a process is one atomic guarded command. A process that dies loses everything but its
 * checkpoint or record, and the new one in its place is there at once.
 */

#ifndef EPOCHS
#define EPOCHS 3
#endif
#ifndef CRASHES
#define CRASHES 1
#endif
#ifndef REDOS
#define REDOS 0
#endif

#include "common.pml"
#define R 3 /* another process for the arm; the owner is beside the world's */
#define NAME(p) IF((p) == R, A, (p))

/* A message is a number, and a box a sorted bag: it is read in any order. */
mtype = { DISMISS, TAKEN, TAKEOVER, STATE, HANDOVER, READY, PREPARE, CTX, OBS } /* 9 to 1 */
#define MSG(kind, from, ep, at, ver, inst, val) \
    ((kind) | (from) << 4 | (ep) << 6 | (at) << 9 | (ver) << 12 | (inst) << 16 | (val) << 20)
#define KIND(x) ((x) & 15)
#define FROM(x) ((x) >> 4 & 3)
#define EP(x) ((x) >> 6 & 7)
#define AT(x) ((x) >> 9 & 7)
#define VER(x) ((x) >> 12 & 15)
#define INST(x) ((x) >> 16 & 15)
#define VAL(x) ((x) >> 20 & 15)
#define ROOM 8
int box[32];
byte filled[4];
byte linked[16];
#define LINKED(q, name) linked[(q) * 4 + (name)] /* the newest instance that q's process has opened its link to */

/* Rosters by version: each node's instance (0: not in it), and whether R is the arm's process. */
#define VERSIONS 9
byte of_world[VERSIONS], of_arm[VERSIONS], of_spatial[VERSIONS];
bit by_r[VERSIONS];
#define INSTANCE(v, name) IF((name) == W, of_world[v], IF((name) == A, of_arm[v], of_spatial[v]))
#define PLAYS(v, p) ((p) == W || (p) == A && !by_r[v] || (p) == R && by_r[v] || (p) == S && of_spatial[v] != 0)
#ifdef DIAMOND
#define BELOW(p) IF((p) == S, 3, 1)
#define ABOVE_WORLD(v) IF(of_spatial[v] != 0, 6, 2)
#define SPATIAL_ON_WORLD(v) (of_spatial[v] != 0)
#else
#define BELOW(p) IF((p) == S, 2, 1)
#define ABOVE_WORLD(v) 2
#define SPATIAL_ON_WORLD(v) false
#endif

/* The nodes' processes; [0] is not used. */
#define AWAY 0  /* dismissed, or never there */
#define ASKS 1  /* says that it is there, until the owner hears it */
#define HEARD 2 /* waits to be prepared */
#define UP 3
#define SENSE 0
#define SENDS_UP 1
#define PREDICT 2
#define SENDS_DOWN 3
#define SENDS_DOWN_2 4
#define SAVES_LATE 5
#define DONE 6
byte life[4], instance[4], version[4], epoch[4], attempt[4], phase[4], start[4], now[4], got[4];
byte known[4]; /* a bit for each version that it was prepared for or has fetched */
bit joins[4];  /* it was in no epoch yet */
byte saved_epoch[4], saved_attempt[4], saved_start[4], saved_now[4]; /* checkpoint; epoch 0: there is none */
#ifdef DAMAGE
byte older_epoch[4], older_attempt[4], older_start[4], older_now[4]; /* the other slot */
#endif
#define HAS(p, v) (known[p] >> ((v) - 1) & 1)

/* The world, and the owner beside it. */
#define BEGUN 0
#define BEGUN_2 1
#define WAITS 2
#define PREDICTED 3
#define BACK 4
#ifdef MUT_RECORD_LATE
#define RECORDS_LATE 5
#define AFTER_SENDING RECORDS_LATE
#else
#define AFTER_SENDING WAITS
#endif
byte w_version = 1, w_epoch, w_attempt, w_phase = PREDICTED, w_start, w_now, w_got;
byte plan;               /* the version that is prepared; 0: none */
byte target;             /* of the change in it: S, R, or 0 */
bit urgent;              /* the epoch under way does not end without it */
byte to_tell, to_answer; /* bits of processes */
byte hand;               /* of the arm's state: 1 asked for, 2 handed on, 3 taken over */
byte committed_attempt;  /* of the last epoch */
byte r_version = 1, r_epoch = 1, r_attempt, r_highest = 1, r_start, r_committed; /* the world's record */
#define COMMITTED IF(w_phase == PREDICTED, w_epoch, w_epoch - 1)
#ifdef MUT_SINGLE_PHASE
#define PREPARED (plan != 0 && to_tell == 0)
#else
#define PREPARED (plan != 0 && to_tell == 0 && to_answer == 0)
#endif
#define SETTLED (PREPARED && (target != R || hand == 3))

/* What may still happen, and what was seen. */
byte crashes = CRASHES, redos = REDOS;
bit finished, refused;
byte commits, last_epoch, last_attempt;
byte first_epoch; /* of spatial; 0: it was in none */
#define FORMAL(p, ep) IF((p) == S, 2 * ((ep) - first_epoch + 1), 2 * (ep)) /* either half of an epoch adds one */

/* ---- what a message is to its receiver: taken, dropped at once, or else held ---- */

#ifdef MUT_IGNORE_INSTANCE
#define RIGHT_SENDER(v, x) true
#define RIGHT_RECEIVER(p, v) true
#else
#define RIGHT_SENDER(v, x) (INST(x) == INSTANCE(v, NAME(FROM(x))))
#define RIGHT_RECEIVER(p, v) (INSTANCE(v, NAME(p)) == instance[p])
#endif
#ifdef MUT_STALE_ATTEMPT
#define CURRENT(x, at) (AT(x) <= (at))
#else
#define CURRENT(x, at) (AT(x) == (at))
#endif
#define DATA(x) (KIND(x) <= CTX)
#define MOVES_ON(p, x) (joins[p] || phase[p] == DONE && EP(x) == epoch[p] + 1)
#define AGAIN(p, x) (!joins[p] && EP(x) == epoch[p] && AT(x) > attempt[p])
#define MISSING(p, x) \
    IF(KIND(x) == OBS, phase[p] == SENSE && (got[p] >> NAME(FROM(x)) & 1) == 0, phase[p] == PREDICT)
#define THIS(p, x) (!joins[p] && EP(x) == epoch[p] && CURRENT(x, attempt[p]) && VER(x) == version[p])
#define TAKES_OBS(p, x) \
    (VER(x) >= version[p] && HAS(p, VER(x)) && RIGHT_RECEIVER(p, VER(x)) && RIGHT_SENDER(VER(x), x) && \
     (MOVES_ON(p, x) || AGAIN(p, x) || THIS(p, x) && MISSING(p, x)))
#define TAKES(p, x) \
    (KIND(x) == OBS && TAKES_OBS(p, x) || KIND(x) == CTX && THIS(p, x) && MISSING(p, x) || !DATA(x))
#define LATE(p, x) \
    (!joins[p] && (EP(x) < epoch[p] || EP(x) == epoch[p] && AT(x) <= attempt[p] && !CURRENT(x, attempt[p]) || \
                   THIS(p, x) && IF(KIND(x) == OBS, !MISSING(p, x), phase[p] > PREDICT)))
#define DROPS(p, x) \
    (life[p] == AWAY || \
     DATA(x) && (life[p] != UP || VER(x) < version[p] || LATE(p, x) || \
                 HAS(p, VER(x)) && RIGHT_RECEIVER(p, VER(x)) && !RIGHT_SENDER(VER(x), x)) || \
     KIND(x) == PREPARE && (life[p] == ASKS || life[p] == HEARD && INSTANCE(VER(x), NAME(p)) != VER(x) || \
                            life[p] == UP && VER(x) <= version[p]) || \
     (KIND(x) == HANDOVER || KIND(x) == TAKEOVER) && (life[p] != UP || VER(x) < version[p]))
#define W_TAKES(x) \
    (KIND(x) == CTX && w_phase == WAITS && VER(x) == w_version && RIGHT_SENDER(w_version, x) && \
         EP(x) == w_epoch && CURRENT(x, w_attempt) && (w_got >> NAME(FROM(x)) & 1) == 0 || \
     KIND(x) == READY && VER(x) == plan && (to_answer >> FROM(x) & 1) || \
     KIND(x) == STATE && VER(x) == plan && hand == 1 || \
     KIND(x) == TAKEN && VER(x) == plan && hand == 2)
#ifdef MUT_VERSION_REUSED
#define OF_NO_PLAN(x) (VER(x) < plan)
#else
#define OF_NO_PLAN(x) (VER(x) != plan)
#endif
#define W_DROPS(x) \
    (KIND(x) == CTX && (VER(x) < w_version || EP(x) < w_epoch || w_phase == PREDICTED || !CURRENT(x, w_attempt) || \
                        !RIGHT_SENDER(w_version, x) || (w_got >> NAME(FROM(x)) & 1)) || \
     KIND(x) >= READY && OF_NO_PLAN(x))

/* ---- boxes and links ---- */

hidden int x, y;
hidden byte i, j;
#define BOX(p, k) box[(p) * ROOM + (k)]

#define FULL(p, x) (DATA(x) && !PLAYS(w_version, p) && filled[p] > 2)

inline put(to, message) {
    y = message;
    if
    :: IF(to == W, W_DROPS(y), DROPS(to, y))
    :: !IF(to == W, W_DROPS(y), DROPS(to, y)) && FULL(to, y) /* a replaced process does not hold on to more and more */
    :: else ->
        assert(filled[to] < ROOM); /* the model's own limit */
        j = filled[to];
        do
        :: j > 0 && BOX(to, j - 1) > y -> BOX(to, j) = BOX(to, j - 1); j--
        :: else -> break
        od;
        BOX(to, j) = y;
        filled[to]++
    fi
}

inline pick(p, k) { /* x = the k-th message of p's box, which it leaves */
    x = BOX(p, k);
    j = k;
    do
    :: j + 1 < filled[p] -> BOX(p, j) = BOX(p, j + 1); j++
    :: else -> break
    od;
    filled[p]--;
    BOX(p, filled[p]) = 0
}

inline clean(p) { /* drop what will never be of use: as good as dropping it later, and fewer states */
    i = 0;
    j = 0;
    do
    :: i < filled[p] ->
        y = BOX(p, i);
        BOX(p, i) = 0;
        if
        :: IF(p == W, W_DROPS(y), DROPS(p, y))
        :: else -> BOX(p, j) = y; j++
        fi;
        i++
    :: else -> break
    od;
    filled[p] = j
}

inline send(from, its_instance, to, message) { /* lost where the link is not open */
    if
    :: (to == W || life[to] == UP) && LINKED(to, NAME(from)) >= its_instance -> put(to, message)
    :: else
    fi
}

/* ---- a node's process ---- */

inline save(p) {
#ifdef DAMAGE
    older_epoch[p] = saved_epoch[p]; older_attempt[p] = saved_attempt[p];
    older_start[p] = saved_start[p]; older_now[p] = saved_now[p];
#endif
    saved_epoch[p] = epoch[p]; saved_attempt[p] = attempt[p];
    saved_start[p] = start[p]; saved_now[p] = now[p]
}

inline predict(p) {
    now[p]++;
#if defined(MUT_CHECKPOINT_LATE) || defined(MUT_CHECKPOINT_SKIPPED)
#else
    save(p);
#endif
    phase[p] = SENDS_DOWN
}

inline sense(p) {
    if
    :: got[p] == BELOW(p) ->
        now[p]++;
        phase[p] = SENDS_UP;
        if
        :: p == S || of_spatial[version[p]] == 0 -> predict(p) /* nothing above it */
        :: else
        fi
    :: else
    fi
}


inline take_observations(p) {
    if
    :: MOVES_ON(p, x) ->
#ifdef DAMAGE
        if /* the state that it begins with is of the attempt that was committed */
        :: !joins[p] && VER(x) == w_version && EP(x) == COMMITTED + 1 -> assert(attempt[p] == committed_attempt)
        :: else
        fi;
#endif
#ifndef MUT_WRONG_START
        start[p] = now[p];
#endif
        got[p] = 0
    :: !MOVES_ON(p, x) && AGAIN(p, x) ->
#ifndef MUT_WRONG_ROLLBACK
        now[p] = start[p];
#endif
        got[p] = 0
    :: else -> i = 1 /* of the attempt under way */
    fi;
    if
    :: i == 0 ->
        joins[p] = 0;
        epoch[p] = EP(x);
        attempt[p] = AT(x);
        version[p] = VER(x);
        known[p] = known[p] >> (VER(x) - 1) << (VER(x) - 1);
        phase[p] = SENSE
    :: else
    fi;
    got[p] = got[p] | 1 << NAME(FROM(x));
    assert_input(p);
    assert(VAL(x) == IF(FROM(x) == W, EP(x) - 1, 2 * EP(x) - 1));
    sense(p)
}

inline assert_input(p) { /* only what is of this roster, instance, epoch and attempt is ever used */
    assert(VER(x) == version[p] && EP(x) == epoch[p] && AT(x) == attempt[p]);
    assert(INST(x) == INSTANCE(version[p], NAME(FROM(x))) && PLAYS(version[p], FROM(x)));
    assert(instance[p] == INSTANCE(version[p], NAME(p)) && PLAYS(version[p], p))
}

inline open_link(q, name, inst) { /* those that are open stay so, also when an older roster comes later */
    if
    :: inst > LINKED(q, name) -> LINKED(q, name) = inst
    :: else
    fi
}

inline link(q, v) {
    open_link(q, W, of_world[v]);
    open_link(q, A, of_arm[v]);
    open_link(q, S, of_spatial[v])
}

inline prepare(p) {
    if
    :: INSTANCE(VER(x), NAME(p)) == VER(x) -> /* it is new, to this roster */
        life[p] = UP; instance[p] = VER(x); version[p] = VER(x); known[p] = 0
    :: else
    fi;
    known[p] = known[p] | 1 << (VER(x) - 1);
    link(p, VER(x));
    put(W, MSG(READY, p, 0, 0, VER(x), 0, 0))
}

inline hand_over(p) { /* the state after epoch EP(x) */
    i = IF(joins[p], 0, IF(epoch[p] == EP(x), now[p], start[p]));
    put(W, MSG(STATE, p, EP(x), 0, VER(x), 0, i))
}

inline take_over(p) {
    epoch[p] = EP(x); attempt[p] = AT(x); start[p] = VAL(x); now[p] = VAL(x);
    joins[p] = (EP(x) == 0);
    phase[p] = DONE;
#ifndef MUT_HANDOVER_NOT_SAVED
    save(p);
#endif
    put(W, MSG(TAKEN, p, EP(x), 0, VER(x), 0, 0))
}

inline leave(p) {
    printf("%d leaves\n", p);
    life[p] = AWAY;
    forget(p);
    clean(p)
}

inline forget(p) { /* what a process that is gone knew */
    instance[p] = 0; version[p] = 0; known[p] = 0; phase[p] = DONE; got[p] = 0;
    epoch[p] = 0; attempt[p] = 0; start[p] = 0; now[p] = 0; joins[p] = 1;
    LINKED(p, W) = 0; LINKED(p, A) = 0; LINKED(p, S) = 0
}

inline receive(p) {
    i = 0;
    printf("%d gets %e of %d: epoch %d, attempt %d, roster %d, value %d\n",
           p, KIND(x), FROM(x), EP(x), AT(x), VER(x), VAL(x));
    if
    :: KIND(x) == OBS -> take_observations(p)
    :: KIND(x) == CTX ->
        assert_input(p);
        assert(VAL(x) == FORMAL(S, EP(x)));
        predict(p)
    :: KIND(x) == PREPARE -> prepare(p)
    :: KIND(x) == HANDOVER -> hand_over(p)
    :: KIND(x) == TAKEOVER -> take_over(p)
    :: KIND(x) == DISMISS -> leave(p)
    fi;
    clean(p)
}

inline finish_epoch(p) {
#ifdef MUT_NODE_COMMITS
    start[p] = now[p];
#endif
    phase[p] = DONE;
    printf("%d has sent down\n", p);
    clean(p)
}

/* A message of a roster that it does not have: it asks for that; a roster that names another process ends it. */
#define LACKS(p, k) (filled[p] > k && life[p] == UP && DATA(BOX(p, k)) && VER(BOX(p, k)) > version[p] && \
                     !HAS(p, VER(BOX(p, k))))
#define REPLACED(p, k) (filled[p] > k && life[p] == UP && DATA(BOX(p, k)) && VER(BOX(p, k)) > version[p] && \
                        HAS(p, VER(BOX(p, k))) && !RIGHT_RECEIVER(p, VER(BOX(p, k))))
#define OF_USE(p, k) (filled[p] > k && TAKES(p, BOX(p, k)))

proctype node(byte p) {
    byte k;
    {
    do
    :: atomic {
        if
        :: OF_USE(p, 0)
        :: OF_USE(p, 1) -> k = 1
        :: OF_USE(p, 2) -> k = 2
        :: OF_USE(p, 3) -> k = 3
        :: OF_USE(p, 4) -> k = 4
        :: OF_USE(p, 5) -> k = 5
        :: OF_USE(p, 6) -> k = 6
        :: OF_USE(p, 7) -> k = 7
        fi;
        d_step { pick(p, k); receive(p); k = 0 } }
    :: atomic {
        if
        :: LACKS(p, 0)
        :: LACKS(p, 1) -> k = 1
        :: LACKS(p, 2) -> k = 2
        :: LACKS(p, 3) -> k = 3
        :: LACKS(p, 4) -> k = 4
        fi;
        d_step { known[p] = known[p] | 1 << (VER(BOX(p, k)) - 1); clean(p); k = 0 } }
    :: d_step { REPLACED(p, 0) || REPLACED(p, 1) || REPLACED(p, 2) || REPLACED(p, 3) || REPLACED(p, 4) -> leave(p) }
    :: d_step { life[p] == UP && phase[p] == SENDS_UP ->
        phase[p] = PREDICT;
        printf("%d sends up\n", p);
        send(p, instance[p], S, MSG(OBS, p, epoch[p], attempt[p], version[p], instance[p], now[p]));
        clean(p) }
    :: d_step { life[p] == UP && phase[p] == SENDS_DOWN && p == S ->
        send(S, instance[S], A, MSG(CTX, S, epoch[S], attempt[S], version[S], instance[S], now[S]));
        send(S, instance[S], R, MSG(CTX, S, epoch[S], attempt[S], version[S], instance[S], now[S]));
#ifdef DIAMOND
        phase[S] = SENDS_DOWN_2 }
    :: d_step { life[p] == UP && phase[p] == SENDS_DOWN_2 ->
        send(S, instance[S], W, MSG(CTX, S, epoch[S], attempt[S], version[S], instance[S], now[S]));
#endif
#ifdef MUT_CHECKPOINT_LATE
        phase[S] = SAVES_LATE }
#else
        finish_epoch(S) }
#endif
    :: d_step { life[p] == UP && phase[p] == SENDS_DOWN && p != S ->
        send(p, instance[p], W, MSG(CTX, p, epoch[p], attempt[p], version[p], instance[p], now[p]));
#ifdef MUT_CHECKPOINT_LATE
        phase[p] = SAVES_LATE }
    :: d_step { life[p] == UP && phase[p] == SAVES_LATE -> save(p); finish_epoch(p) }
#else
        finish_epoch(p) }
#endif
    od
    } unless { finished || refused }
}

/* ---- the owner ---- */

#define LOST(p) (PLAYS(w_version, p) && (life[p] == ASKS || life[p] == HEARD || \
                                         life[p] == UP && instance[p] != INSTANCE(w_version, NAME(p))))
#define ASKS_BACK(p) (life[p] == ASKS && PLAYS(w_version, p))
#define MUST_PLAN \
    (ASKS_BACK(A) || ASKS_BACK(S) || ASKS_BACK(R) || w_phase == BACK && plan == 0 || \
     urgent && target != 0 && life[target] == ASKS)
/* The change that is wanted: it is in the plan that is given up, or somebody asks. */
#define WANTS_S (of_spatial[w_version] == 0 && (life[S] == ASKS || target == S))
/* A state is handed over between two epochs only: one under way may still be committed meanwhile. */
#ifdef MUT_HANDOVER_MIDWAY
#define MAY_HAND_OVER true
#else
#define MAY_HAND_OVER (w_phase == PREDICTED || w_phase == BACK)
#endif
#define WANTS_R (!by_r[w_version] && (life[R] == ASKS || target == R))
/* A process with this checkpoint can go on. */
#define NEWCOMER(p) ((p) == S && first_epoch == 0 || COMMITTED + 1 == IF((p) == S, first_epoch, 1))
#ifdef MUT_JOIN_ANY_ATTEMPT
#define RIGHT_ATTEMPT(p) true
#else
#define RIGHT_ATTEMPT(p) (attempt[p] == committed_attempt)
#endif
#ifdef MUT_JOIN_WITHOUT_CHECKPOINT
#define MAY_BE_NEW(p) true
#else
#define MAY_BE_NEW(p) NEWCOMER(p)
#endif
#define SOUND(p) \
    IF(joins[p], MAY_BE_NEW(p), epoch[p] == COMMITTED + 1 || epoch[p] == COMMITTED && RIGHT_ATTEMPT(p))

inline check_sound(p) {
    if
    :: !SOUND(p) ->
#ifdef DAMAGE
        refused = 1
#else
        assert(false) /* a process that just died must be able to come back */
#endif
    :: else
    fi
}

inline readmit(p) {
    check_sound(p);
    life[p] = HEARD;
    if
    :: p == S -> of_spatial[plan] = plan
    :: else -> of_arm[plan] = plan
    fi
}

inline make_plan(change) {
    if
    :: target != 0 && change != target -> life[target] = ASKS; clean(target)
    :: else
    fi;
    urgent = w_phase == BACK || LOST(A) || LOST(S) || LOST(R);
#ifdef MUT_VERSION_REUSED
    plan = w_version + 1;
#else
    plan = r_highest + 1;
#endif
    assert(plan < VERSIONS); /* the model's own limit */
    r_highest = plan; /* recorded before anybody hears of it */
    of_world[plan] = IF(w_phase == BACK, plan, of_world[w_version]);
    of_arm[plan] = of_arm[w_version];
    of_spatial[plan] = of_spatial[w_version];
    by_r[plan] = by_r[w_version];
    if :: LOST(A) -> readmit(A) :: else fi;
    if :: LOST(R) -> readmit(R) :: else fi;
    if :: LOST(S) -> readmit(S) :: else fi;
    target = change;
    if
    :: change == S -> of_spatial[plan] = plan; life[S] = HEARD
    :: change == R -> of_arm[plan] = plan; by_r[plan] = 1; life[R] = HEARD
    :: else
    fi;
    hand = 0;
    to_answer = IF(by_r[plan], 1 << R, 1 << A); /* every change in this model touches the arm */
    if
    :: of_spatial[plan] != 0 && (of_spatial[plan] == plan || of_arm[plan] == plan ||
                              SPATIAL_ON_WORLD(plan) && of_world[plan] == plan) ->
        to_answer = to_answer | 1 << S
    :: else
    fi;
    to_tell = to_answer;
    printf("owner prepares roster %d: world %d, arm %d (of process %d), spatial %d; urgent %d\n",
           plan, of_world[plan], of_arm[plan], IF(by_r[plan], R, A), of_spatial[plan], urgent);
    link(W, plan);
    clean(A); clean(S); clean(R); clean(W)
}

inline tell(p) {
    to_tell = to_tell & ~(1 << p);
    put(p, MSG(PREPARE, W, 0, 0, plan, 0, 0))
}

/* ---- the world ---- */

inline check_node(p) { /* when an epoch is committed */
    if
    :: !PLAYS(w_version, p) || LOST(p) || life[p] == AWAY -> skip
    :: else ->
        assert(epoch[p] == w_epoch && attempt[p] == w_attempt && version[p] == w_version);
        assert(phase[p] >= SENDS_DOWN && now[p] == FORMAL(p, w_epoch))
    fi;
#ifndef DAMAGE
    if
    :: !PLAYS(w_version, p) -> skip
    :: else ->
        assert(saved_epoch[p] == w_epoch && saved_attempt[p] == w_attempt && saved_now[p] == FORMAL(p, w_epoch))
    fi
#endif
}

inline commit() { /* an epoch is committed when what follows it is on record */
    if
    :: w_epoch > 0 ->
        printf("world commits epoch %d, attempt %d\n", w_epoch, w_attempt);
        assert(commits == w_epoch - 1);
        commits = w_epoch;
        assert(w_now == w_epoch);
        check_node(A);
        check_node(R);
        check_node(S)
    :: else
    fi
}

inline record() {
    r_version = w_version; r_epoch = w_epoch; r_attempt = w_attempt; r_start = w_start; r_committed = committed_attempt
}

inline begin(new_epoch, with_plan) {
    if
    :: new_epoch -> commit(); w_epoch++; w_start = w_now; w_attempt = 1
    :: else -> w_now = w_start;
#ifdef MUT_ATTEMPT_REUSED
        if :: w_phase != BACK || w_attempt == 0 -> w_attempt++ :: else fi
#else
        w_attempt++
#endif
    fi;
    assert(w_epoch > last_epoch || w_epoch == last_epoch && w_attempt > last_attempt); /* no attempt's number twice */
    last_epoch = w_epoch;
    last_attempt = w_attempt;
    if
    :: with_plan ->
        w_version = plan;
        plan = 0; target = 0; urgent = 0; hand = 0; to_tell = 0; to_answer = 0
    :: else
    fi;
    if
    :: first_epoch == 0 && of_spatial[w_version] != 0 -> first_epoch = w_epoch
    :: else
    fi;
#ifndef MUT_RECORD_LATE
    record();
#endif
    w_got = 0;
    w_phase = BEGUN;
    printf("world begins epoch %d, attempt %d, under roster %d\n", w_epoch, w_attempt, w_version);
#ifdef DAMAGE
    check_again(A, with_plan); check_again(R, with_plan); check_again(S, with_plan);
#endif
    clean(W)
}

inline check_again(p, with_plan) { /* the epoch that was under way when it came back may have been committed meanwhile */
#ifndef MUT_JOIN_CHECKED_ONCE
    if
    :: with_plan && PLAYS(w_version, p) && instance[p] == w_version -> check_sound(p)
    :: else
    fi
#else
    skip
#endif
}

inline world_receives() {
    printf("world gets %e of %d: epoch %d, attempt %d, roster %d, value %d\n",
           KIND(x), FROM(x), EP(x), AT(x), VER(x), VAL(x));
    if
    :: KIND(x) == CTX ->
        assert(VER(x) == w_version && EP(x) == w_epoch && AT(x) == w_attempt);
        assert(INST(x) == INSTANCE(w_version, NAME(FROM(x))) && PLAYS(w_version, FROM(x)));
        assert(VAL(x) == FORMAL(FROM(x), EP(x)));
        w_got = w_got | 1 << NAME(FROM(x));
        if
        :: w_got == ABOVE_WORLD(w_version) -> world_predicts()
        :: else
        fi
    :: KIND(x) == READY -> to_answer = to_answer & ~(1 << FROM(x))
    :: KIND(x) == STATE ->
        hand = 2;
        put(R, MSG(TAKEOVER, W, COMMITTED, committed_attempt, plan, 0, VAL(x)))
    :: KIND(x) == TAKEN ->
        hand = 3;
#ifdef MUT_DISMISSED_EARLY
        put(A, MSG(DISMISS, W, 0, 0, 0, 0, 0));
#endif
    fi;
    clean(W)
}

inline world_predicts() {
    w_now++;
    w_phase = PREDICTED;
    committed_attempt = w_attempt;
    w_got = 0
}

#define OF_USE_TO_W(k) (filled[W] > k && W_TAKES(BOX(W, k)))

proctype world() {
    byte k;
    {
    do
    :: atomic {
        if
        :: OF_USE_TO_W(0)
        :: OF_USE_TO_W(1) -> k = 1
        :: OF_USE_TO_W(2) -> k = 2
        :: OF_USE_TO_W(3) -> k = 3
        :: OF_USE_TO_W(4) -> k = 4
        fi;
        d_step { pick(W, k); world_receives(); k = 0 } }

    /* plans: of who comes back, with or without the change that is wanted; of a change alone */
    :: d_step { MUST_PLAN -> make_plan(0) }
    :: d_step { MUST_PLAN && WANTS_S -> make_plan(S) }
    :: d_step { MUST_PLAN && WANTS_R && MAY_HAND_OVER && !LOST(A) -> make_plan(R) }
    :: d_step { !MUST_PLAN && !urgent && WANTS_S && w_phase != BACK && life[S] == ASKS -> make_plan(S) }
    :: d_step { !MUST_PLAN && !urgent && WANTS_R && w_phase != BACK && life[R] == ASKS -> make_plan(R) }
    :: d_step { by_r[w_version] && life[A] == ASKS -> leave(A) }
    :: d_step { to_tell >> A & 1 -> tell(A) }
    :: d_step { to_tell >> S & 1 -> tell(S) }
    :: d_step { to_tell >> R & 1 -> tell(R) }
    :: d_step { PREPARED && target == R && hand == 0 && (w_phase == PREDICTED || urgent && MAY_HAND_OVER) && !MUST_PLAN ->
        hand = 1;
        put(A, MSG(HANDOVER, W, COMMITTED, 0, plan, 0, 0)) }

    /* epochs and attempts */
    :: d_step { w_phase == PREDICTED && w_epoch < EPOCHS && (plan == 0 || !urgent && !PREPARED) -> begin(true, false) }
    :: d_step { w_phase == PREDICTED && w_epoch < EPOCHS && SETTLED -> begin(true, true) }
    :: d_step { (w_phase <= WAITS && urgent || w_phase == BACK) && SETTLED -> begin(false, true) }
    :: d_step { w_phase == WAITS && redos > 0 && !urgent -> redos--; begin(false, false) }
    :: d_step { w_phase == BEGUN ->
        send(W, of_world[w_version], A, MSG(OBS, W, w_epoch, w_attempt, w_version, of_world[w_version], w_start));
        send(W, of_world[w_version], R, MSG(OBS, W, w_epoch, w_attempt, w_version, of_world[w_version], w_start));
        if
        :: by_r[w_version] && life[A] != AWAY && BOX(A, 0) != MSG(DISMISS, W, 0, 0, 0, 0, 0) -> put(A, MSG(DISMISS, W, 0, 0, 0, 0, 0))
        :: else
        fi;
        w_phase = IF(SPATIAL_ON_WORLD(w_version), BEGUN_2, AFTER_SENDING) }
    :: d_step { w_phase == BEGUN_2 ->
        send(W, of_world[w_version], S, MSG(OBS, W, w_epoch, w_attempt, w_version, of_world[w_version], w_start));
        w_phase = AFTER_SENDING }
#ifdef MUT_RECORD_LATE
    :: d_step { w_phase == RECORDS_LATE -> record(); w_phase = WAITS }
#endif
#ifdef MUT_COMMIT_EARLY
    :: d_step { w_phase == WAITS -> world_predicts(); clean(W) }
#endif
    :: d_step { w_phase == PREDICTED && w_epoch == EPOCHS -> commit(); finished = 1 }
    od
    } unless { finished || refused }
}

/* ---- what goes wrong ---- */

inline die(p, damaged) {
    printf("%d dies, damaged: %d\n", p, damaged);
    crashes--;
    forget(p);
    life[p] = ASKS;
#ifdef DAMAGE
    if
    :: damaged ->
        saved_epoch[p] = older_epoch[p]; saved_attempt[p] = older_attempt[p];
        saved_start[p] = older_start[p]; saved_now[p] = older_now[p];
        older_epoch[p] = 0; older_attempt[p] = 0; older_start[p] = 0; older_now[p] = 0
    :: else
    fi;
#endif
    epoch[p] = saved_epoch[p]; attempt[p] = saved_attempt[p]; start[p] = saved_start[p]; now[p] = saved_now[p];
    joins[p] = (saved_epoch[p] == 0);
    clean(p)
}

/* The new owner hears of nobody but the nodes of its record; who else is there asks anew, or has given up. */
inline start_over(p, tries) {
    if
    :: life[p] == HEARD ||
       life[p] == UP && !(PLAYS(r_version, p) && instance[p] == INSTANCE(r_version, NAME(p))) && !PLAYS(1, p) ->
        life[p] = IF(tries || PLAYS(r_version, p), ASKS, AWAY);
        if :: life[p] == AWAY -> leave(p) :: else -> clean(p) fi
    :: else
    fi
}

inline world_dies(tries) {
    printf("world dies\n");
    crashes--;
    w_version = r_version; w_epoch = r_epoch; w_attempt = r_attempt; w_start = r_start; w_now = 0; w_got = 0;
    committed_attempt = r_committed;
    w_phase = BACK;
    plan = 0; target = 0; urgent = 0; hand = 0; to_tell = 0; to_answer = 0;
    LINKED(W, A) = 0; LINKED(W, S) = 0;
    start_over(A, tries); start_over(S, tries); start_over(R, tries);
    clean(W)
}

proctype fate() {
    {
    do
    :: crashes == 0 -> break
    :: d_step { crashes > 0 && life[A] >= HEARD -> die(A, false) }
    :: d_step { crashes > 0 && life[S] >= HEARD -> die(S, false) }
    :: d_step { crashes > 0 && life[R] >= HEARD -> die(R, false) }
#ifdef DAMAGE
    :: d_step { crashes > 0 && life[A] >= HEARD -> die(A, true) }
    :: d_step { crashes > 0 && life[S] >= HEARD -> die(S, true) }
    :: d_step { crashes > 0 && life[R] >= HEARD -> die(R, true) }
#endif
    :: d_step { crashes > 0 -> world_dies(true) }
    :: d_step { crashes > 0 && (life[S] == HEARD || life[R] >= HEARD || target != 0) -> world_dies(false) }
    od
    } unless { finished || refused }
}

inline establish(p) {
    life[p] = UP; instance[p] = 1; version[p] = 1; known[p] = 1; joins[p] = 1; phase[p] = DONE;
    link(p, 1)
}

init {
    d_step {
        of_world[1] = 1; of_arm[1] = 1;
#ifdef ATTACH
        life[S] = ASKS; phase[S] = DONE; joins[S] = 1;
#else
        of_spatial[1] = 1;
        establish(S);
#endif
#ifdef REPLACE
        life[R] = ASKS; phase[R] = DONE; joins[R] = 1;
#endif
        establish(A);
        link(W, 1)
    }
    atomic { run world(); run node(A); run node(S); run node(R); run fate() }
}

ltl ends { <> (finished || refused) }
