/* SPDX-License-Identifier: Apache-2.0
 *
 * The commit and the recovery of native/core/txn.h and recover.h, small enough that spin visits every state: two frames,
 * three writer slots, two readers; a writer dies between any two stores, and with -DCRASHES=2 whoever adopts its slot too.
 * Rings are long enough that nothing is evicted: eviction is the business of the scheduler beside this file.
 *
 *   -DALONE      one writer of both frames, to be killed: with -DCRASHES=2 every pair of deaths is visited in a minute
 *   -DATOMICITY  two writers of both frames: a reader sees one transaction in both, and what was finished before it began
 *   -DFORK       one writer of each frame: no two readers see the two commits in different orders
 *   -DSHAPE      a is put below b, b below a, each having looked at the other; a third writer commits in between
 *
 *   -DGOES_ON    who adopts a slot writes both frames next (always with ALONE)
 *
 * In each, what a reader finds in a frame is compared with `truth`, kept by the commits themselves; at the end no lock is
 * left, and what is read then is what was committed.  The switches named WITHOUT_ and WITH_ plant one error each; models.py
 * runs them too, and each has to be found.  Every access to a shared word is a step of its own.
 *
 *   spin -a -DATOMICITY -DCRASHES=1 commit.pml && cc -O2 -DSAFETY -DCOLLAPSE -o pan pan.c && ./pan -m1000000
 */
#ifndef CRASHES
#define CRASHES 0
#endif

#define NF 2
#define CAP 6

/* lock: owned, sel, slot, number of the transaction.  A record's tag: a version, or its owner's lock without sel. */
#define OWNED 128
#define SEL 64
#define NO_SEL 191
#define MAKE(slot, number) (OWNED + (slot) * 16 + (number))
#define SLOT_OF(lock) (((lock) / 16) % 4)
#define NUMBER_OF(lock) ((lock) % 16)
#define SEL_OF(lock) (((lock) / 64) % 2)
#define RELEASED(lock) ((lock) - OWNED)
#define APPLIED(lock) (((lock) - OWNED) ^ SEL)

/* state: kind, whether it changes the shape, version.  commit: version and slot. */
#define ACTIVE 0
#define PREPARED 32
#define COMMITTED 64
#define SHAPES 16
#define KIND(state) ((state) & 96)
#define VERSION(state) ((state) % 16)
#define COMMIT(version, slot) ((version) * 4 + (slot))
#define DECIDED(word, slot, state) (KIND(state) == COMMITTED || (KIND(state) == PREPARED && (word) == COMMIT(VERSION(state), slot)))

#if defined SHAPE
#define WRITERS 3
#elif defined ALONE
#define WRITERS 1
#else
#define WRITERS 2
#endif
#if defined ALONE || defined GOES_ON
#define WRITES true
#else
#define WRITES false
#endif

byte commit = 3; /* version 0, by a slot that nobody has */
byte topology;
byte state[4], number[4], live_from[4];
byte lock[NF], head[NF * 2];
byte tag[NF * CAP], val[NF * CAP];
bool dead, adopter_dead, adopted, finished[5];
byte truth[16 * NF];
byte seen[2 * NF];
byte writers_done;

/* Before each store: the first owner of slot 0, or who adopts it, may be killed. */
#define STORE(store) atomic { \
    if \
    :: true \
    :: CRASHES > 0 && slot == 0 && me == 0 -> dead = true; goto out \
    :: CRASHES > 1 && me == 1 -> adopter_dead = true; goto out \
    fi; \
    store }

/* Values that are not looked at again must not tell states apart. */
#define FORGET atomic { l = 0; st = 0; b = 0; h = 0; c = 0; x = 0; own = 0 }
#define FORGET_ALL atomic { l = 0; st = 0; b = 0; h = 0; c = 0; x = 0; own = 0; r = 0; g = 0; v = 0; s = 0; t0 = 0; found = 0; tries = 0; la = false; lb = false; won = false }

inline raise_topology(v) { d_step { if :: topology < v -> topology = v :: else fi } }

inline topology_at(g, result) {
  st = state[g % 4];
  if
  :: KIND(st) != ACTIVE && VERSION(st) == g / 4 && g / 4 > 0 && (st & SHAPES) -> result = g / 4
  :: else -> result = topology
  fi
}

/* recover_settle */
inline settle(g) {
  st = state[g % 4];
  if
  :: KIND(st) == PREPARED && VERSION(st) == g / 4 && g / 4 > 0 ->
#ifndef WITHOUT_HELPERS_TOPOLOGY
     if :: (st & SHAPES) -> STORE(raise_topology(g / 4)) :: else fi;
#endif
     STORE(d_step { if :: state[g % 4] == st -> state[g % 4] = st - PREPARED + COMMITTED :: else fi })
  :: else
  fi
}

/* ring_apply: tags, then the lock with the other head in force */
inline apply(f, l, v) {
  b = head[f * 2 + SEL_OF(l)];
  h = head[f * 2 + 1 - SEL_OF(l)];
  if
  :: lock[f] == l ->
     do
     :: b < h -> STORE(d_step { if :: tag[f * CAP + b] == (l & NO_SEL) -> tag[f * CAP + b] = v :: else fi; b++ })
     :: else -> break
     od;
     STORE(d_step { if :: lock[f] == l -> lock[f] = APPLIED(l) :: else fi })
  :: else
  fi
}

/* finish_if_decided: result 0: neither, 1: the lock has moved on, 2: finished here */
inline finish_if_decided(f, l, result) {
  c = commit;
  st = state[SLOT_OF(l)];
  if
  :: lock[f] != l -> result = 1
  :: else ->
     if
     :: DECIDED(c, SLOT_OF(l), st) -> apply(f, l, VERSION(st)); result = 2
     :: else -> result = 0
     fi
  fi
}

/* recover_dead */
inline undo(f, l) {
#ifdef WITHOUT_SECOND_LOOK
  r = 0;
#else
  finish_if_decided(f, l, r);
#endif
  if
  :: r == 0 ->
#ifdef WITH_PLAIN_RELEASE
     STORE(lock[f] = RELEASED(l))
#else
     STORE(d_step { if :: lock[f] == l -> lock[f] = RELEASED(l) :: else fi })
#endif
  :: else
  fi
}

/* The transaction whose record is the frame's newest at S: view_take and latest_in_view of ring.c. */
inline read_frame(f, s, result) {
  do
  :: true ->
#ifdef WITH_HEAD_FIRST
     h = head[f * 2]; b = head[f * 2 + 1];
#endif
     l = lock[f];
     d_step { own = 0; x = SEL_OF(l) };
     if
     :: l >= OWNED ->
        st = state[SLOT_OF(l)];
#ifndef WITHOUT_DECIDED
        if
        :: DECIDED(s, SLOT_OF(l), st) && VERSION(st) <= s / 4 -> d_step { x = 1 - x; own = l & NO_SEL; c = VERSION(st) }
        :: else
        fi
#endif
     :: else
     fi;
#ifdef WITH_HEAD_FIRST
     h = (x == 0 -> h : b);
#else
     h = head[f * 2 + x];
#endif
     if
     :: lock[f] != l -> h = 255
     :: else ->
        do
        :: h == 0 -> result = 0; break
        :: h > 0 ->
           b = tag[f * CAP + h - 1];
           if
           :: b >= OWNED && b != own -> h = 255; break /* again */
           :: b >= OWNED && b == own -> b = c
           :: else
           fi;
#ifdef WITHOUT_VERSIONS
           if :: true -> result = val[f * CAP + h - 1]; break fi
#else
           if :: b <= s / 4 -> result = val[f * CAP + h - 1]; break :: else -> h-- fi
#endif
        od
     fi;
     if :: h != 255 -> break :: else -> FORGET fi
  od;
  FORGET
}

/* Take a frame's lock.  r: 0 taken, 1 held by somebody undecided */
inline take(f) {
  r = 1;
  l = lock[f];
  if
  :: l >= OWNED ->
     finish_if_decided(f, l, r);
     if
     :: r == 0 && NUMBER_OF(l) < live_from[SLOT_OF(l)] -> undo(f, l)
     :: else
     fi;
     l = lock[f]
  :: else
  fi;
  r = 1;
  if
  :: l < OWNED -> STORE(d_step { if :: lock[f] == l -> lock[f] = MAKE(slot, number[slot]) | (l & SEL); r = 0 :: else fi })
  :: else
  fi;
  FORGET
}

/* The owner's own unlock or release of frame f. */
inline leave(f, new) { d_step { if :: lock[f] >= OWNED && (lock[f] & NO_SEL) == MAKE(slot, number[slot]) -> lock[f] = new :: else fi } }

inline release_all() {
  if :: la -> STORE(leave(0, RELEASED(lock[0]))) :: else fi;
  if :: lb -> STORE(leave(1, RELEASED(lock[1]))) :: else fi;
  la = false; lb = false
}

/* A record behind the head in force, and the head to come. */
inline stage(f) {
  d_step { x = SEL_OF(lock[f]); b = head[f * 2 + x] };
  STORE(tag[f * CAP + b] = MAKE(slot, number[slot]));
  STORE(val[f * CAP + b] = id);
#ifndef WITH_HEAD_AFTER_COMMIT
  STORE(head[f * 2 + 1 - x] = b + 1);
#endif
  FORGET
}
inline tag_early(f) { STORE(d_step { x = SEL_OF(lock[f]); tag[f * CAP + head[f * 2 + x]] = v }) }
inline late_head(f) { STORE(d_step { x = SEL_OF(lock[f]); head[f * 2 + 1 - x] = head[f * 2 + x] + 1 }) }

/* The commit itself, and what it makes true. */
inline compare_and_swap() {
  d_step {
    won = false;
    if
    :: commit == g ->
       commit = COMMIT(v, slot);
       truth[v * NF] = (wa -> id : truth[(v - 1) * NF]);
       truth[v * NF + 1] = (wb -> id : truth[(v - 1) * NF + 1]);
       won = true
    :: else
    fi
  }
}

/* me: 0 the first owner of the slot, 1 and 2 its adopters.  check: the record of the other frame that forbids this. */
inline transact() {
  tries = 0;
again:
  STORE(number[slot] = number[slot] + 1);
  STORE(state[slot] = ACTIVE);
  s = commit;
  topology_at(s, t0);
  if :: t0 > s / 4 -> goto again :: else fi;
  if :: wa -> take(0); la = (r == 0) :: else fi;
  if :: wb && (!wa || la) -> take(1); lb = (r == 0) :: else fi;
  if
  :: (wa && !la) || (wb && !lb) ->
     release_all();
     if :: tries == 0 -> tries = 1; goto again :: else -> goto refused fi
  :: else
  fi;
  if
  :: check > 0 ->
     if :: wa -> read_frame(1, s, found) :: else -> read_frame(0, s, found) fi;
     if :: found == check -> release_all(); goto refused :: else fi
  :: else
  fi;
  if :: wa -> stage(0) :: else fi;
  if :: wb -> stage(1) :: else fi;
  do
  :: true ->
     g = commit;
#ifndef WITHOUT_TOPOLOGY_CHECK
     topology_at(g, v);
     if :: v != t0 -> release_all(); if :: tries == 0 -> tries = 1; goto again :: else -> goto refused fi :: else fi;
#endif
#ifndef WITHOUT_SETTLE
     if :: g % 4 != slot -> settle(g) :: else fi;
     FORGET;
#endif
     v = g / 4 + 1;
     if :: wa -> tag_early(0) :: else fi;
     if :: wb -> tag_early(1) :: else fi;
     STORE(state[slot] = PREPARED + shapes + v);
     STORE(compare_and_swap());
#ifdef SHAPE
     assert(!(truth[v * NF] == 1 && truth[v * NF + 1] == 2)); /* a below b below a */
#endif
     if :: won -> break :: else fi
  od;
#ifdef WITH_HEAD_AFTER_COMMIT
  if :: wa -> late_head(0) :: else fi;
  if :: wb -> late_head(1) :: else fi;
#endif
#ifndef WITHOUT_OWNERS_TOPOLOGY
  if :: shapes > 0 -> STORE(raise_topology(v)) :: else fi;
#endif
  STORE(state[slot] = COMMITTED + shapes + v);
  if :: wa -> STORE(leave(0, APPLIED(lock[0]))) :: else fi;
  if :: wb -> STORE(leave(1, APPLIED(lock[1]))) :: else fi;
  finished[id] = true;
refused: skip
}

#define LOCALS byte l, st, b, h, c, r, x, g, v, s, t0, own, found, tries; bool la, lb, won

proctype writer(byte slot; byte id; bool wa; bool wb; byte shapes; byte check) {
  LOCALS;
  byte me = (slot == 0 -> 0 : 3);
  transact();
out:
  skip;
  FORGET_ALL;
  writers_done++
}

/* recover_adopt, and a transaction of the new owner */
proctype adopter(byte me; bool writes) {
  LOCALS;
  byte slot = 0, id = 3, shapes = 0, check = 0;
  bool wa = true, wb = true;
  byte f;
  if
  :: me == 1 && dead -> skip
  :: me == 2 && adopter_dead -> skip
  :: adopted || (!dead && writers_done == WRITERS) -> goto out
  fi;
#ifdef WITH_NUMBERS_AGAIN
  live_from[0] = number[0] + 1; number[0] = 0;
#else
  STORE(live_from[0] = number[0] + 1);
#endif
  g = commit; settle(g);
  f = 0;
  do
  :: f < NF ->
     l = lock[f];
     if :: l >= OWNED && SLOT_OF(l) == 0 -> undo(f, l) :: else fi;
     f++
  :: else -> break
  od;
  assert(!(lock[0] >= OWNED && SLOT_OF(lock[0]) == 0) && !(lock[1] >= OWNED && SLOT_OF(lock[1]) == 0));
  if :: writes -> transact() :: else fi;
  adopted = true;
out:
  skip;
  FORGET_ALL
}

proctype reader(byte i; bool a_first) {
  byte s, l, st, b, h, c, x, own, va, vb;
  bool before1 = finished[1], before2 = finished[2];
  s = commit;
  if
  :: a_first -> read_frame(0, s, va); read_frame(1, s, vb)
  :: else -> read_frame(1, s, vb); read_frame(0, s, va)
  fi;
  assert(va == truth[(s / 4) * NF] && vb == truth[(s / 4) * NF + 1]);
#ifdef ATOMICITY
  assert(va == vb);
  assert(!((before1 || before2) && va == 0));
#endif
#ifdef FORK
  d_step { seen[i * NF] = va; seen[i * NF + 1] = vb };
#endif
  d_step { s = 0; va = 0; vb = 0; before1 = false; before2 = false }
}

init {
  byte s, l, st, b, h, c, x, own, va, vb;
  atomic {
#ifdef ALONE
    run writer(0, 1, true, true, 0, 0);
#endif
#ifdef ATOMICITY
    run writer(0, 1, true, true, 0, 0); run writer(1, 2, true, true, 0, 0);
#endif
#ifdef FORK
    run writer(0, 1, true, false, 0, 0); run writer(1, 2, false, true, 0, 0);
#endif
#ifdef SHAPE
    run writer(0, 1, true, false, SHAPES, 2); run writer(1, 2, false, true, SHAPES, 1); run writer(2, 4, false, true, 0, 0);
#else
    run reader(0, true);
#ifdef FORK
    run reader(1, false);
#endif
#endif
    if :: CRASHES > 0 -> run adopter(1, WRITES) :: else fi;
    if :: CRASHES > 1 -> run adopter(2, WRITES) :: else fi
  }
  (_nr_pr == 1); /* all are done: nothing is left behind, and the last commit is what a reader finds */
  assert(lock[0] < OWNED && lock[1] < OWNED);
  s = commit;
  read_frame(0, s, va);
  read_frame(1, s, vb);
  assert(va == truth[(s / 4) * NF] && vb == truth[(s / 4) * NF + 1]);
#ifdef FORK
  assert(!(seen[0] == 1 && seen[1] != 2 && seen[2] != 1 && seen[3] == 2));
  assert(!(seen[2] == 1 && seen[3] != 2 && seen[0] != 1 && seen[1] == 2));
#endif
}
