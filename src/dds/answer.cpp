// Facts that are said again: samples within a sample.
#include <convoy/dds/convert.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/dds/wire_bounds.hpp>
#include <convoy/geometry/groups.hpp>

namespace convoy::dds {
namespace {

using eprosima::fastrtps::rtps::SerializedPayload_t;

template <class Sample>
struct TypeOf;  // its topic type, and the kind of fact
#define CONVOY_TYPE_OF(Name, Kind)                        \
  template <>                                             \
  struct TypeOf<v1::Name> {                               \
    using PubSubType = v1::Name##PubSubType;              \
    static constexpr v1::FactKind kind = v1::KIND_##Kind; \
  }
CONVOY_TYPE_OF(Bias, ANCHOR);
CONVOY_TYPE_OF(Landmark, LANDMARK);
CONVOY_TYPE_OF(Prior, PRIOR);
CONVOY_TYPE_OF(Association, ASSOCIATION);
CONVOY_TYPE_OF(Verdict, VERDICT);
CONVOY_TYPE_OF(AbsoluteFix, ABSOLUTE_FIX);
CONVOY_TYPE_OF(Encounter, ENCOUNTER);
CONVOY_TYPE_OF(Waypoint, WAYPOINT);
#undef CONVOY_TYPE_OF

/// Made once: its constructor walks all that the type may hold, and what is used here keeps no state.
template <class Sample>
GuardedType<typename TypeOf<Sample>::PubSubType>& type_of() {
  static GuardedType<typename TypeOf<Sample>::PubSubType> type;
  return type;
}

/// A payload of bytes that stay somebody else's.
class Borrowed {
 public:
  explicit Borrowed(const std::vector<std::uint8_t>& bytes) {
    payload.data = const_cast<std::uint8_t*>(bytes.data());  // which are only read
    payload.length = payload.max_size = static_cast<std::uint32_t>(bytes.size());
  }
  ~Borrowed() { payload.data = nullptr; }
  Borrowed(const Borrowed&) = delete;
  Borrowed& operator=(const Borrowed&) = delete;
  SerializedPayload_t payload;
};

template <class Sample, class G>
WireStatus open(const v1::RepeatedFact& fact, Message<G>& message) {
  Borrowed bytes(fact.sample());
  Guarded<Sample> inner;
  type_of<Sample>().deserialize(&bytes.payload, &inner);
  if (inner.decoding != Decoding::ok) return WireStatus::bad_answer;
  const WireStatus status = from_wire(inner.sample, message);
  message.repeated = true;
  return status;
}

template <class G>
WireStatus open(const v1::RepeatedFact& fact, Message<G>& message) {
  switch (fact.kind()) {
    case v1::KIND_ANCHOR: return open<v1::Bias>(fact, message);
    case v1::KIND_LANDMARK: return open<v1::Landmark>(fact, message);
    case v1::KIND_PRIOR: return open<v1::Prior>(fact, message);
    case v1::KIND_ASSOCIATION: return open<v1::Association>(fact, message);
    case v1::KIND_VERDICT: return open<v1::Verdict>(fact, message);
    case v1::KIND_ABSOLUTE_FIX: return open<v1::AbsoluteFix>(fact, message);
    case v1::KIND_ENCOUNTER: return open<v1::Encounter>(fact, message);
    case v1::KIND_WAYPOINT: return open<v1::Waypoint>(fact, message);
  }
  return WireStatus::unknown_enum;
}

std::size_t size_of(const v1::RepeatedFact& fact) { return 4 + 4 + (fact.sample().size() + 3) / 4 * 4; }

std::size_t size_of(const v1::Answer& answer) {
  std::size_t size = 4 + 4 + 4 + 8 + 4;  // encapsulation, vehicle, its padding, epoch, length
  for (const v1::RepeatedFact& fact : answer.facts()) size += size_of(fact);
  return size;
}

}  // namespace

template <class Sample>
WireStatus to_repeated(Sample& sample, v1::RepeatedFact& fact) {
  auto& type = type_of<Sample>();
  SerializedPayload_t payload(type.getSerializedSizeProvider(&sample)());
  if (!type.serialize(&sample, &payload) || payload.length > bounds::repeated_bytes) return WireStatus::too_many;
  fact.kind(TypeOf<Sample>::kind);
  fact.sample().assign(payload.data, payload.data + payload.length);
  return WireStatus::ok;
}

bool has_room(const v1::Answer& answer, const ChainId& sender, const v1::RepeatedFact& fact) {
  if (answer.facts().empty()) return true;
  return ChainId{answer.vehicle(), answer.epoch()} == sender && answer.facts().size() < bounds::repeated &&
         size_of(answer) + size_of(fact) <= max_sample_bytes;
}

void append(v1::Answer& answer, const ChainId& sender, v1::RepeatedFact fact) {
  answer.vehicle(sender.vehicle);
  answer.epoch(sender.epoch);
  answer.facts().push_back(std::move(fact));
}

template <class G>
WireStatus from_wire(const v1::Answer& answer, std::vector<Message<G>>& messages) {
  if (answer.facts().empty()) return WireStatus::bad_answer;
  if (answer.facts().size() > 1 && size_of(answer) > max_sample_bytes) return WireStatus::too_many;
  messages.reserve(answer.facts().size());
  const ChainId sender{answer.vehicle(), answer.epoch()};
  for (const v1::RepeatedFact& fact : answer.facts()) {
    const WireStatus status = open(fact, messages.emplace_back());
    if (status != WireStatus::ok) return status;
    if (messages.back().sender != sender) return WireStatus::bad_answer;
  }
  return WireStatus::ok;
}

template WireStatus to_repeated(v1::Bias&, v1::RepeatedFact&);
template WireStatus to_repeated(v1::Landmark&, v1::RepeatedFact&);
template WireStatus to_repeated(v1::Prior&, v1::RepeatedFact&);
template WireStatus to_repeated(v1::Association&, v1::RepeatedFact&);
template WireStatus to_repeated(v1::Verdict&, v1::RepeatedFact&);
template WireStatus to_repeated(v1::AbsoluteFix&, v1::RepeatedFact&);
template WireStatus to_repeated(v1::Encounter&, v1::RepeatedFact&);
template WireStatus to_repeated(v1::Waypoint&, v1::RepeatedFact&);

#define CONVOY_INSTANTIATE(G) template WireStatus from_wire(const v1::Answer&, std::vector<Message<G>>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::dds
