/* SPDX-License-Identifier: Apache-2.0
 *
 * E7: a frame is bound to another name while its name is read: never the new name under the old gen, or the reverse.
 * -DHINTS, E8: two frames are bound to two names of one bucket: neither binder takes the other's new hint for garbage.
 */
#include "scenario.h"

static const name_key old_name = {7ull << 48, {'x'}, 1}, new_name = {8ull << 48, {'y'}, 1}, third_name = {8ull << 48 | 1, {'z'}, 1};
static bool bound[2];

static void *binder(void *unused) {
    (void)unused;
    shmtf_frame f;
    bound[0] = names_bind_locked(&s, 1, &new_name, true, &f);
    return NULL;
}

static void *other_binder(void *unused) {
    (void)unused;
    shmtf_frame f;
    bound[1] = names_bind_locked(&s, 2, &third_name, true, &f);
    return NULL;
}

static void *reader(void *unused) {
    (void)unused;
    shmtf_frame f;
    assert(!names_leads(&s, hint_make(new_name.hash, 2, 1), &new_name, &f));
    assert(!names_leads(&s, hint_make(old_name.hash, 4, 1), &old_name, &f));
    return NULL;
}

int main(void) {
    pthread_t t[2];
    shmtf_frame f;
    make_segment();
#ifdef HINTS
    pthread_create(&t[0], NULL, binder, NULL);
    pthread_create(&t[1], NULL, other_binder, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    assert(bound[0] && bound[1]);
    assert(names_guess(&s, &new_name, &f) && names_guess(&s, &third_name, &f));
#else
    names_bind_locked(&s, 1, &old_name, true, &f);
    pthread_create(&t[0], NULL, binder, NULL);
    pthread_create(&t[1], NULL, reader, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
#endif
    return 0;
}
