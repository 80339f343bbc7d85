// Facts that are said again: a sample within a sample.
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
WireStatus open(const v1::Answer& answer, Message<G>& message) {
  Borrowed bytes(answer.sample());
  Guarded<Sample> inner;
  GuardedType<typename TypeOf<Sample>::PubSubType>().deserialize(&bytes.payload, &inner);
  if (inner.decoding != Decoding::ok) return WireStatus::bad_answer;
  const WireStatus status = from_wire(inner.sample, message);
  if (status != WireStatus::ok) return status;
  message.repeated = true;
  const ChainId sender{answer.vehicle(), answer.epoch()};
  return message.sender == sender ? WireStatus::ok : WireStatus::bad_answer;
}

}  // namespace

template <class Sample>
WireStatus to_answer(const ChainId& sender, Sample& sample, v1::Answer& answer) {
  GuardedType<typename TypeOf<Sample>::PubSubType> type;
  SerializedPayload_t payload(type.getSerializedSizeProvider(&sample)());
  if (!type.serialize(&sample, &payload) || payload.length > bounds::answer_bytes) return WireStatus::too_many;
  answer.vehicle(sender.vehicle);
  answer.epoch(sender.epoch);
  answer.kind(TypeOf<Sample>::kind);
  answer.sample().assign(payload.data, payload.data + payload.length);
  return WireStatus::ok;
}

template <class G>
WireStatus from_wire(const v1::Answer& answer, Message<G>& message) {
  switch (answer.kind()) {
    case v1::KIND_ANCHOR: return open<v1::Bias>(answer, message);
    case v1::KIND_LANDMARK: return open<v1::Landmark>(answer, message);
    case v1::KIND_PRIOR: return open<v1::Prior>(answer, message);
    case v1::KIND_ASSOCIATION: return open<v1::Association>(answer, message);
    case v1::KIND_VERDICT: return open<v1::Verdict>(answer, message);
    case v1::KIND_ABSOLUTE_FIX: return open<v1::AbsoluteFix>(answer, message);
    case v1::KIND_ENCOUNTER: return open<v1::Encounter>(answer, message);
    case v1::KIND_WAYPOINT: return open<v1::Waypoint>(answer, message);
  }
  return WireStatus::unknown_enum;
}

template WireStatus to_answer(const ChainId&, v1::Bias&, v1::Answer&);
template WireStatus to_answer(const ChainId&, v1::Landmark&, v1::Answer&);
template WireStatus to_answer(const ChainId&, v1::Prior&, v1::Answer&);
template WireStatus to_answer(const ChainId&, v1::Association&, v1::Answer&);
template WireStatus to_answer(const ChainId&, v1::Verdict&, v1::Answer&);
template WireStatus to_answer(const ChainId&, v1::AbsoluteFix&, v1::Answer&);
template WireStatus to_answer(const ChainId&, v1::Encounter&, v1::Answer&);
template WireStatus to_answer(const ChainId&, v1::Waypoint&, v1::Answer&);

#define CONVOY_INSTANTIATE(G) template WireStatus from_wire(const v1::Answer&, Message<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::dds
