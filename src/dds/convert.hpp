// Messages of the core <-> samples of the wire. No exceptions: what does not fit is refused with a reason.
#pragma once

#include <convoy/idl/convoy.h>
#include <convoy/exchange/message.hpp>

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace convoy::dds {

enum class WireStatus : std::uint8_t {
  ok,
  wrong_dimension,  ///< a sample of an SE(3) fleet in an SE(2) one, or the reverse
  wrong_size,       ///< a sequence has not the length that its dimension asks for, or parallel ones differ
  unknown_enum,     ///< a number that names nothing
  too_many,         ///< more elements than the format allows
  not_finite,       ///< a NaN or an infinity
  out_of_range,     ///< an angle beyond pi, a quaternion not of length one, a vehicle 0, an empty range or batch
  not_symmetric,    ///< to the wire: a covariance whose packed form would not give the same matrix back
  not_rounded,      ///< to the wire: a landmark that would not come back as it is, see rounded()
  not_canonical,    ///< landmarks in another form than the one that they have
  bad_answer,       ///< the sample in an answer is none of its kind, or of another sender
};
const char* to_string(WireStatus status);

/// To the wire. Covariances must be symmetric to the bit, because only their upper triangle travels and the content
/// hash covers all of it. `sender` is who puts the sample on the wire.
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const AnchorFact<G>& fact, v1::Bias& sample);
/// All of one chain and one anchor, rounded, not empty, at most 64.
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, std::span<const LandmarkFact<G>> batch, v1::Landmark& sample);
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const PriorFact<G>& fact, v1::Prior& sample);
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const AbsoluteFixFact<G>& fact, v1::AbsoluteFix& sample);
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const EncounterFact<G>& fact, v1::Encounter& sample);
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const WaypointFact<G>& fact, v1::Waypoint& sample);
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const LivePose<G>& pose, v1::Pose& sample);
/// What follows says nothing of the group; name that of the fleet: to_wire<G>(...).
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const AssociationFact& fact, v1::Association& sample);
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const VerdictFact& fact, v1::Verdict& sample);
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const Request& request, v1::Request& sample);
template <class G>
[[nodiscard]] WireStatus to_wire(const ChainId& sender, const Digest& digest, v1::Digest& sample);

/// A sample of a fact, as above, to be said again in an answer of `sender`, the sender in the sample.
template <class Sample>
[[nodiscard]] WireStatus to_repeated(Sample& sample, v1::RepeatedFact& fact);
/// Whether `fact` can go in `answer`: it is empty, or the same sender's and stays below max_sample_bytes.
bool has_room(const v1::Answer& answer, const ChainId& sender, const v1::RepeatedFact& fact);
void append(v1::Answer& answer, const ChainId& sender, v1::RepeatedFact fact);

/// From the wire. A digest of a fleet of the other dimension is let through, for its receiver to count. `message` is
/// meaningful only if the status is ok. Whether the content is plausible (positive covariances, limits of coordinates)
/// is the business of FactStore.
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Bias& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Landmark& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Prior& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Association& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Verdict& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::AbsoluteFix& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Encounter& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Waypoint& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Pose& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Request& sample, Message<G>& message);
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Digest& sample, Message<G>& message);
/// One message of each fact, `repeated`, all of one sender. All or nothing.
template <class G>
[[nodiscard]] WireStatus from_wire(const v1::Answer& answer, std::vector<Message<G>>& messages);

/// Serialised size of a Landmark sample, and of an Answer of several facts, is no more than this, so that it fits one
/// Ethernet frame with all headers; a Landmark sample does so in an Answer, too.
inline constexpr std::size_t max_sample_bytes = 1200;

/// Cuts a batch, in order, into parts that each make one Landmark sample: one chain, one anchor, at most 64 landmarks
/// and max_sample_bytes.
template <class G>
std::vector<std::span<const LandmarkFact<G>>> split(std::span<const LandmarkFact<G>> batch);

}  // namespace convoy::dds
