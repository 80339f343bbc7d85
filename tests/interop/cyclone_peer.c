// A program of somebody else's, on another DDS: it subscribes to convoy's Bias, Landmark and Pose by the IDL alone.
//   cyclone_peer DOMAIN
// CYCLONEDDS_URI must say on which interface, since by default Cyclone DDS speaks on one of its own choice.
//
// Prints "ready", then one line for every anchor, every sample of landmarks and every pose that arrives: the topic and
// all fields in the order of the IDL, separated by spaces; real numbers as the hexadecimal digits of their bits,
// sequences led by their length. Driven by lines on standard input, until its end:
//   repeat VEHICLE    writes all Bias and Landmark samples once more, with VEHICLE as their sender, and forgets them
//   end               prints what there still is, then "end"
#include "convoy.h"

#include <dds/dds.h>

#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { samples_at_once = 256, poll_ms = 5 };

static dds_entity_t need(dds_entity_t entity, const char* what) {
  if (entity >= 0) return entity;
  fprintf(stderr, "cyclone_peer: no %s: %s\n", what, dds_strretcode(-entity));
  exit(1);
}

// ---- text -----------------------------------------------------------------------------------------------------

static void whole(uint64_t value) { printf(" %" PRIu64, value); }

static void real(double value) {
  uint64_t bits;
  memcpy(&bits, &value, sizeof bits);
  printf(" %016" PRIx64, bits);
}

static void short_real(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  printf(" %08" PRIx32, bits);
}

#define SEQUENCE(print, sequence)                                                       \
  do {                                                                                  \
    whole((sequence)._length);                                                          \
    for (uint32_t i_ = 0; i_ < (sequence)._length; ++i_) print((sequence)._buffer[i_]); \
  } while (0)

static void chain(const convoy_v1_Chain* c) {
  whole(c->epoch);
  whole(c->vehicle);
}

static void state(const convoy_v1_ChainState* s) {
  real(s->stamp_s);
  real(s->abscissa_m);
  SEQUENCE(real, s->pose);
  SEQUENCE(real, s->drift);
  SEQUENCE(real, s->heading_lever);
}

static void print_bias(const void* sample) {
  const convoy_v1_Bias* b = sample;
  printf("Bias");
  chain(&b->sender);
  whole(b->vehicle);
  whole(b->epoch);
  whole(b->index);
  whole(b->dimension);
  state(&b->state);
  whole(b->first_landmark);
  whole(b->landmark_count);
  printf("\n");
}

static void print_landmark(const void* sample) {
  const convoy_v1_Landmark* l = sample;
  printf("Landmark");
  chain(&l->sender);
  whole(l->vehicle);
  whole(l->epoch);
  whole(l->anchor);
  whole(l->dimension);
  SEQUENCE(whole, l->index);
  SEQUENCE(whole, l->kind);
  SEQUENCE(whole, l->descriptor_kind);
  SEQUENCE(whole, l->descriptor);
  SEQUENCE(short_real, l->position);
  SEQUENCE(short_real, l->covariance);
  SEQUENCE(whole, l->loading);
  printf("\n");
}

static void print_pose(const void* sample) {
  const convoy_v1_Pose* p = sample;
  printf("Pose");
  chain(&p->sender);
  whole(p->vehicle);
  whole(p->epoch);
  whole(p->anchor);
  whole(p->dimension);
  whole(p->integrity);
  whole(p->reasons);
  state(&p->state);
  SEQUENCE(whole, p->remembered);
  SEQUENCE(short_real, p->remembered_points);
  SEQUENCE(real, p->remembered_shared);
  printf("\n");
}

// ---- topics ---------------------------------------------------------------------------------------------------

static void set_bias_sender(void* sample, uint32_t vehicle) { ((convoy_v1_Bias*)sample)->sender.vehicle = vehicle; }
static void set_landmark_sender(void* sample, uint32_t vehicle) {
  ((convoy_v1_Landmark*)sample)->sender.vehicle = vehicle;
}

struct topic {
  const char* name;
  const dds_topic_descriptor_t* type;
  void (*print)(const void* sample);
  void (*set_sender)(void* sample, uint32_t vehicle);  // of facts alone: they may be repeated
  dds_entity_t topic, reader;
};

static struct topic topics[] = {
    {"convoy/v1/Bias", &convoy_v1_Bias_desc, print_bias, set_bias_sender, 0, 0},
    {"convoy/v1/Landmark", &convoy_v1_Landmark_desc, print_landmark, set_landmark_sender, 0, 0},
    {"convoy/v1/Pose", &convoy_v1_Pose_desc, print_pose, NULL, 0, 0},
};
enum { topic_count = sizeof topics / sizeof *topics };

// As qos_profiles/README.md says. Only the reader of poses keeps more than the last: it tells of each.
static dds_qos_t* qos_of(const struct topic* t) {
  dds_qos_t* qos = dds_create_qos();
  const bool fact = t->set_sender != NULL;
  dds_qset_reliability(qos, fact ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT, DDS_SECS(1));
  dds_qset_durability(qos, fact ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
  dds_qset_history(qos, DDS_HISTORY_KEEP_ALL, 0);
  // Without it a writer that keeps all still gives late joiners the last sample of each key alone.
  dds_qset_durability_service(qos, 0, DDS_HISTORY_KEEP_ALL, 0, DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED,
                              DDS_LENGTH_UNLIMITED);
  dds_qset_ignorelocal(qos, DDS_IGNORELOCAL_PARTICIPANT);
  return qos;
}

static void subscribe(dds_entity_t participant, struct topic* t) {
  dds_qos_t* qos = qos_of(t);
  t->topic = need(dds_create_topic(participant, t->type, t->name, NULL, NULL), t->name);
  t->reader = need(dds_create_reader(participant, t->topic, qos, NULL), "reader");
  dds_delete_qos(qos);
}

// Samples stay with the reader, for repeat().
static void print_new(const struct topic* t) {
  for (;;) {
    void* samples[samples_at_once] = {NULL};
    dds_sample_info_t infos[samples_at_once];
    const dds_return_t n = need(dds_read_mask(t->reader, samples, infos, samples_at_once, samples_at_once,
                                              DDS_NOT_READ_SAMPLE_STATE | DDS_ANY_VIEW_STATE | DDS_ANY_INSTANCE_STATE),
                                "samples");
    if (n == 0) return;
    for (dds_return_t i = 0; i < n; ++i)
      if (infos[i].valid_data) t->print(samples[i]);
    dds_return_loan(t->reader, samples, n);
  }
}

// In pieces as print_new()'s: once a reader of Cyclone DDS 0.10.2 has lent more samples, it writes as many pointers
// into a shorter array as well.
static void repeat(dds_entity_t participant, struct topic* t, uint32_t vehicle) {
  if (t->set_sender == NULL) return;
  dds_qos_t* qos = qos_of(t);
  const dds_entity_t writer = need(dds_create_writer(participant, t->topic, qos, NULL), "writer");
  dds_delete_qos(qos);
  for (;;) {
    void* samples[samples_at_once] = {NULL};
    dds_sample_info_t infos[samples_at_once];
    const dds_return_t n = need(dds_take(t->reader, samples, infos, samples_at_once, samples_at_once), "samples");
    if (n == 0) return;
    for (dds_return_t i = 0; i < n; ++i) {
      if (!infos[i].valid_data) continue;
      t->set_sender(samples[i], vehicle);
      need(dds_write(writer, samples[i]), "room to write");
    }
    dds_return_loan(t->reader, samples, n);
  }
}

int main(int argc, char** argv) {
  if (argc != 2 || getenv("CYCLONEDDS_URI") == NULL) {
    fprintf(stderr, "usage: CYCLONEDDS_URI=file:///...xml cyclone_peer DOMAIN\n");
    return 2;
  }
  const dds_entity_t participant =
      need(dds_create_participant((dds_domainid_t)strtoul(argv[1], NULL, 10), NULL, NULL), "participant");
  for (int i = 0; i < topic_count; ++i) subscribe(participant, &topics[i]);
  setvbuf(stdin, NULL, _IONBF, 0);  // so that poll() knows of every line
  printf("ready\n");
  for (;;) {
    for (int i = 0; i < topic_count; ++i) print_new(&topics[i]);
    fflush(stdout);
    struct pollfd in = {STDIN_FILENO, POLLIN, 0};
    if (poll(&in, 1, poll_ms) <= 0) continue;
    char line[64];
    uint32_t vehicle = 0;
    if (fgets(line, sizeof line, stdin) == NULL) break;
    if (sscanf(line, "repeat %" SCNu32, &vehicle) == 1)
      for (int i = 0; i < topic_count; ++i) repeat(participant, &topics[i], vehicle);
    if (strcmp(line, "end\n") == 0) {
      for (int i = 0; i < topic_count; ++i) print_new(&topics[i]);
      printf("end\n");
    }
  }
  dds_delete(participant);
  return 0;
}
