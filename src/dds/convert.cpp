#include <convoy/dds/convert_parts.hpp>

#include <bit>

namespace convoy::dds {

using namespace parts;

const char* to_string(WireStatus status) {
  switch (status) {
    case WireStatus::ok: return "ok";
    case WireStatus::wrong_dimension: return "wrong dimension";
    case WireStatus::wrong_size: return "wrong size";
    case WireStatus::unknown_enum: return "unknown enumerator";
    case WireStatus::too_many: return "too many elements";
    case WireStatus::not_finite: return "not finite";
    case WireStatus::out_of_range: return "out of range";
    case WireStatus::not_symmetric: return "covariance not symmetric to the bit";
    case WireStatus::not_rounded: return "landmark not rounded";
    case WireStatus::not_canonical: return "not in canonical form";
    case WireStatus::bad_answer: return "no sample of its kind and sender";
  }
  return "unknown";
}

// ---- anchors ---------------------------------------------------------------------------------------------------

template <class G>
WireStatus to_wire(const ChainId& sender, const AnchorFact<G>& fact, v1::Bias& sample) {
  set_key(sender, fact.key, sample);
  sample.dimension(G::Dim);
  sample.first_landmark(fact.first_landmark);
  sample.landmark_count(fact.landmark_count);
  return to_wire_state(fact.state, sample.state());
}

template <class G>
WireStatus from_wire(const v1::Bias& sample, Message<G>& message) {
  AnchorFact<G> fact;
  fact.first_landmark = sample.first_landmark();
  fact.landmark_count = sample.landmark_count();
  fact.key = {author(sample), sample.index()};
  const WireStatus status = first_refusal(check_names(sample), check_dimension<G>(sample));
  if (status != WireStatus::ok) return status;
  const WireStatus state = from_wire_state(sample.state(), fact.state);
  message = {core_chain(sample.sender()), std::move(fact)};
  return state;
}

// ---- priors ----------------------------------------------------------------------------------------------------

template <class G>
WireStatus to_wire(const ChainId& sender, const PriorFact<G>& fact, v1::Prior& sample) {
  set_key(sender, fact.key, sample);
  sample.dimension(G::Dim);
  sample.known(fact.known);
  sample.mean(coordinates(fact.mean));
  sample.scale_sigma(fact.persistent.scale);
  sample.heading_sigma(fact.persistent.heading_rad_per_m);
  sample.tilt_sigma(fact.persistent.tilt_rad);
  sample.height_sigma(fact.persistent.height_m);
  sample.correlation(fact.persistent.correlation_m);
  sample.up(to_wire_unless_zero(fact.persistent.up));
  sample.scales_landmarks(fact.persistent.scales_landmarks);
  return pack(fact.covariance, sample.covariance());
}

template <class G>
WireStatus from_wire(const v1::Prior& sample, Message<G>& message) {
  const WireStatus status = first_refusal(check_names(sample), check_dimension<G>(sample));
  if (status != WireStatus::ok) return status;
  PriorFact<G> fact;
  fact.key = {author(sample), sample.index()};
  fact.known = sample.known();
  PersistentDrift& p = fact.persistent;
  p = {sample.scale_sigma(), sample.heading_sigma(), sample.tilt_sigma(), sample.height_sigma(), sample.correlation()};
  p.scales_landmarks = sample.scales_landmarks();
  const bool finite = all_finite({p.scale, p.heading_rad_per_m, p.tilt_rad, p.height_m, p.correlation_m});
  const WireStatus content =
      first_refusal(from_coordinates(sample.mean(), fact.mean), unpack(sample.covariance(), fact.covariance),
                    finite ? WireStatus::ok : WireStatus::not_finite, from_wire_vector_or_zero(sample.up(), p.up));
  message = {core_chain(sample.sender()), std::move(fact)};
  return content;
}

// ---- associations ----------------------------------------------------------------------------------------------

template <class G>
WireStatus to_wire(const ChainId& sender, const AssociationFact& fact, v1::Association& sample) {
  set_key(sender, fact.key, sample);
  sample.dimension(G::Dim);
  auto& groups = sample.groups();
  groups.clear();
  if (fact.pairings.size() > bounds::pairs) return WireStatus::too_many;
  for (const auto& [first, second] : fact.pairings) {
    const bool same = !groups.empty() && core_chain(groups.back().first_chain()) == first.chain &&
                      core_chain(groups.back().second_chain()) == second.chain;
    if (!same) {
      if (groups.size() == bounds::pairing_groups) return WireStatus::too_many;
      groups.emplace_back();
      groups.back().first_chain(wire_chain(first.chain));
      groups.back().second_chain(wire_chain(second.chain));
    }
    v1::IndexPair pair;
    pair.first(first.index);
    pair.second(second.index);
    groups.back().pairs().push_back(pair);
  }
  return WireStatus::ok;
}

template <class G>
WireStatus from_wire(const v1::Association& sample, Message<G>& message) {
  const WireStatus status = first_refusal(check_names(sample), check_dimension<G>(sample));
  if (status != WireStatus::ok) return status;
  if (sample.groups().size() > bounds::pairing_groups) return WireStatus::too_many;
  AssociationFact fact;
  fact.key = {author(sample), sample.index()};
  for (const v1::PairingGroup& group : sample.groups()) {
    if (fact.pairings.size() + group.pairs().size() > bounds::pairs) return WireStatus::too_many;
    for (const v1::IndexPair& pair : group.pairs())
      fact.pairings.push_back(
          {{core_chain(group.first_chain()), pair.first()}, {core_chain(group.second_chain()), pair.second()}});
  }
  message = {core_chain(sample.sender()), std::move(fact)};
  return WireStatus::ok;
}

// ---- verdicts --------------------------------------------------------------------------------------------------

template <class G>
WireStatus to_wire(const ChainId& sender, const VerdictFact& fact, v1::Verdict& sample) {
  set_key(sender, fact.key, sample);
  sample.dimension(G::Dim);
  sample.hypothesis(fact.hypothesis);
  sample.veto(fact.veto);
  return WireStatus::ok;
}

template <class G>
WireStatus from_wire(const v1::Verdict& sample, Message<G>& message) {
  message = {core_chain(sample.sender()),
             VerdictFact{{author(sample), sample.index()}, sample.hypothesis(), sample.veto()}};
  return first_refusal(check_names(sample), check_dimension<G>(sample));
}

// ---- absolute fixes --------------------------------------------------------------------------------------------

template <class G>
WireStatus to_wire(const ChainId& sender, const AbsoluteFixFact<G>& fact, v1::AbsoluteFix& sample) {
  set_key(sender, fact.key, sample);
  sample.dimension(G::Dim);
  sample.anchor(fact.anchor);
  sample.lever().assign(fact.lever.data(), fact.lever.data() + fact.lever.size());
  sample.position().assign(fact.position.data(), fact.position.data() + fact.position.size());
  return first_refusal(to_wire_state(fact.state, sample.state()), pack(fact.covariance, sample.covariance()));
}

template <class G>
WireStatus from_wire(const v1::AbsoluteFix& sample, Message<G>& message) {
  const WireStatus status = first_refusal(check_names(sample), check_dimension<G>(sample));
  if (status != WireStatus::ok) return status;
  AbsoluteFixFact<G> fact;
  fact.key = {author(sample), sample.index()};
  fact.anchor = sample.anchor();
  const WireStatus content =
      first_refusal(from_wire_state(sample.state(), fact.state), from_wire_vector(sample.lever(), fact.lever),
                    from_wire_vector(sample.position(), fact.position), unpack(sample.covariance(), fact.covariance));
  message = {core_chain(sample.sender()), std::move(fact)};
  return content;
}

// ---- encounters ------------------------------------------------------------------------------------------------

template <class G>
WireStatus to_wire(const ChainId& sender, const EncounterFact<G>& fact, v1::Encounter& sample) {
  set_key(sender, fact.key, sample);
  sample.dimension(G::Dim);
  sample.anchor(fact.anchor);
  sample.other(fact.other);
  sample.position().assign(fact.position.data(), fact.position.data() + fact.position.size());
  return first_refusal(to_wire_state(fact.state, sample.state()), pack(fact.covariance, sample.covariance()));
}

template <class G>
WireStatus from_wire(const v1::Encounter& sample, Message<G>& message) {
  const WireStatus status = first_refusal(check_names(sample), check_dimension<G>(sample));
  if (status != WireStatus::ok) return status;
  EncounterFact<G> fact;
  fact.key = {author(sample), sample.index()};
  fact.anchor = sample.anchor();
  fact.other = sample.other();
  const WireStatus content = first_refusal(
      fact.other != 0 ? WireStatus::ok : WireStatus::out_of_range, from_wire_state(sample.state(), fact.state),
      from_wire_vector(sample.position(), fact.position), unpack(sample.covariance(), fact.covariance));
  message = {core_chain(sample.sender()), std::move(fact)};
  return content;
}

template <class G>
WireStatus to_wire(const ChainId& sender, const WaypointFact<G>& fact, v1::Waypoint& sample) {
  set_key(sender, fact.key, sample);
  sample.dimension(G::Dim);
  sample.anchor(fact.anchor);
  sample.observer(wire_chain(fact.encounter.chain));
  sample.encounter(fact.encounter.index);
  sample.mark().assign(fact.mark.data(), fact.mark.data() + fact.mark.size());
  return to_wire_state(fact.state, sample.state());
}

template <class G>
WireStatus from_wire(const v1::Waypoint& sample, Message<G>& message) {
  const WireStatus status = first_refusal(check_names(sample), check_dimension<G>(sample));
  if (status != WireStatus::ok) return status;
  WaypointFact<G> fact;
  fact.key = {author(sample), sample.index()};
  fact.anchor = sample.anchor();
  fact.encounter = {core_chain(sample.observer()), sample.encounter()};
  const bool answers_somebody = fact.encounter.chain.vehicle != 0;
  const WireStatus content =
      first_refusal(answers_somebody ? WireStatus::ok : WireStatus::out_of_range,
                    from_wire_state(sample.state(), fact.state), from_wire_vector(sample.mark(), fact.mark));
  message = {core_chain(sample.sender()), std::move(fact)};
  return content;
}

// ---- live poses ------------------------------------------------------------------------------------------------

static_assert(LivePose<SE3>::max_remembered == bounds::remembered);
template <class G>
constexpr std::size_t numbers_per_remembered = G::Dim + G::Dim*(G::Dim + 1) / 2;
static_assert(bounds::remembered * numbers_per_remembered<SE3> == bounds::remembered_points);

template <class G>
WireStatus to_wire_remembered(const LivePose<G>& pose, v1::Pose& sample) {
  if (pose.remembered.size() > bounds::remembered) return WireStatus::too_many;
  sample.remembered().clear();
  sample.remembered_points().clear();
  sample.remembered_shared().clear();
  std::vector<double> packed;
  for (const RememberedLandmark<G>& l : pose.remembered) {
    if (const WireStatus status = pack(l.covariance, packed); status != WireStatus::ok) return status;
    sample.remembered().push_back(l.index);
    for (int i = 0; i < G::Dim; ++i) sample.remembered_points().push_back(static_cast<float>(l.position[i]));
    for (const double number : packed) sample.remembered_points().push_back(static_cast<float>(number));
  }
  return pose.remembered.empty() ? WireStatus::ok : pack(pose.shared, sample.remembered_shared());
}

template <class G>
WireStatus from_wire_remembered(const v1::Pose& sample, LivePose<G>& pose) {
  constexpr std::size_t each = numbers_per_remembered<G>;
  const std::size_t n = sample.remembered().size();
  if (n > bounds::remembered) return WireStatus::too_many;
  if (sample.remembered_points().size() != n * each) return WireStatus::wrong_size;
  if (n == 0) return sample.remembered_shared().empty() ? WireStatus::ok : WireStatus::wrong_size;
  auto next = sample.remembered_points().begin();
  for (const std::uint32_t index : sample.remembered()) {
    RememberedLandmark<G> l;
    l.index = index;
    const WireStatus status = first_refusal(from_wire_vector(std::vector<double>(next, next + G::Dim), l.position),
                                            unpack(std::vector<double>(next + G::Dim, next + each), l.covariance));
    if (status != WireStatus::ok) return status;
    pose.remembered.push_back(l);
    next += each;
  }
  return unpack(sample.remembered_shared(), pose.shared);
}

template <class G>
WireStatus to_wire(const ChainId& sender, const LivePose<G>& pose, v1::Pose& sample) {
  sample.sender(wire_chain(sender));
  set_author(pose.chain, sample);
  sample.anchor(pose.anchor);
  sample.dimension(G::Dim);
  sample.integrity(static_cast<v1::Integrity>(pose.integrity));
  sample.reasons(pose.reasons);
  return first_refusal(to_wire_state(pose.state, sample.state()), to_wire_remembered(pose, sample));
}

template <class G>
WireStatus from_wire(const v1::Pose& sample, Message<G>& message) {
  const WireStatus status = first_refusal(check_names(sample), check_dimension<G>(sample));
  if (status != WireStatus::ok) return status;
  LivePose<G> pose;
  pose.chain = author(sample);
  pose.anchor = sample.anchor();
  pose.reasons = sample.reasons();
  const WireStatus content =
      first_refusal(convert_enum(sample.integrity(), v1::INTEGRITY_SUSPECT, pose.integrity),
                    from_wire_state(sample.state(), pose.state), from_wire_remembered(sample, pose));
  message = {core_chain(sample.sender()), std::move(pose)};
  return content;
}

// ---- requests --------------------------------------------------------------------------------------------------

template <class G>
WireStatus to_wire(const ChainId& sender, const Request& request, v1::Request& sample) {
  if (request.ranges.size() > bounds::ranges) return WireStatus::too_many;
  set_author(sender, sample);
  sample.target(wire_chain(request.target));
  sample.kind(static_cast<v1::FactKind>(request.kind));
  sample.in_vain(request.in_vain);
  sample.ranges().clear();
  for (const IndexRange& range : request.ranges) {
    v1::IndexRange out;
    out.first(range.first);
    out.end(range.end);
    sample.ranges().push_back(out);
  }
  return WireStatus::ok;
}

template <class G>
WireStatus from_wire(const v1::Request& sample, Message<G>& message) {
  if (sample.vehicle() == 0) return WireStatus::out_of_range;
  if (sample.ranges().size() > bounds::ranges) return WireStatus::too_many;
  Request request;
  request.target = core_chain(sample.target());
  request.in_vain = sample.in_vain();
  for (const v1::IndexRange& range : sample.ranges()) {
    if (range.first() >= range.end()) return WireStatus::out_of_range;
    if (!request.ranges.empty() && range.first() < request.ranges.back().end) return WireStatus::not_canonical;
    request.ranges.push_back({range.first(), range.end()});
  }
  const WireStatus status = convert_enum(sample.kind(), v1::KIND_WAYPOINT, request.kind);
  message = {author(sample), std::move(request)};
  return status;
}

// ---- digests ---------------------------------------------------------------------------------------------------

template <class G>
WireStatus to_wire(const ChainId& sender, const Digest& digest, v1::Digest& sample) {
  set_author(sender, sample);
  sample.dimension(digest.dimension);
  if (!std::isfinite(digest.stamp_s)) return WireStatus::not_finite;
  sample.stamp_s(digest.stamp_s);
  sample.holdings(digest.holdings);
  sample.facts_digest(digest.facts);
  sample.selection_digest(digest.selection);
  sample.map_digest(digest.map);
  sample.map_facts_digest(digest.map_facts);
  auto& all = sample.marks();
  all.clear();
  for (const ChainMark& mark : digest.marks) {
    const unsigned bit = 1U << static_cast<unsigned>(mark.kind);
    // Bits are read from the lowest up, so a kind joins its chain only if it comes after those that stand there.
    if (all.empty() || core_chain(all.back().chain()) != mark.chain || all.back().kinds() >= bit) {
      if (all.size() == bounds::chains) return WireStatus::too_many;
      all.emplace_back();
      all.back().chain(wire_chain(mark.chain));
    }
    v1::ChainMarks& marks = all.back();
    marks.kinds(static_cast<std::uint8_t>(marks.kinds() | bit));
    marks.high_water().push_back(mark.high_water);
    marks.count().push_back(mark.count);
    marks.hash().push_back(mark.hash);
  }
  return WireStatus::ok;
}

template <class G>
WireStatus from_wire(const v1::Digest& sample, Message<G>& message) {
  if (sample.vehicle() == 0) return WireStatus::out_of_range;
  // A fleet of the other dimension is for the receiver to refuse, who says so; its marks speak of chains that are not
  // ours.
  if (sample.dimension() != SE2::Dim && sample.dimension() != SE3::Dim) return WireStatus::wrong_dimension;
  if (sample.marks().size() > bounds::chains) return WireStatus::too_many;
  Digest digest;
  digest.dimension = sample.dimension();
  if (!std::isfinite(sample.stamp_s())) return WireStatus::not_finite;
  digest.stamp_s = sample.stamp_s();
  digest.holdings = sample.holdings();
  digest.facts = sample.facts_digest();
  digest.selection = sample.selection_digest();
  digest.map = sample.map_digest();
  digest.map_facts = sample.map_facts_digest();
  for (const v1::ChainMarks& marks : sample.marks()) {
    if (marks.kinds() >> fact_kind_count != 0) return WireStatus::unknown_enum;
    const auto n = static_cast<std::size_t>(std::popcount(marks.kinds()));
    if (marks.high_water().size() != n || marks.count().size() != n || marks.hash().size() != n)
      return WireStatus::wrong_size;
    if (marks.chain().vehicle() == 0) return WireStatus::out_of_range;
    std::size_t i = 0;
    for (unsigned kind = 0; kind < fact_kind_count; ++kind)
      if ((marks.kinds() >> kind & 1U) != 0) {
        digest.marks.push_back({core_chain(marks.chain()), static_cast<FactKind>(kind), marks.high_water()[i],
                                marks.count()[i], marks.hash()[i]});
        ++i;
      }
  }
  message = {author(sample), std::move(digest)};
  return WireStatus::ok;
}

#define CONVOY_INSTANTIATE(G)                                                                  \
  template WireStatus to_wire<G>(const ChainId&, const AnchorFact<G>&, v1::Bias&);             \
  template WireStatus to_wire<G>(const ChainId&, const PriorFact<G>&, v1::Prior&);             \
  template WireStatus to_wire<G>(const ChainId&, const AbsoluteFixFact<G>&, v1::AbsoluteFix&); \
  template WireStatus to_wire<G>(const ChainId&, const EncounterFact<G>&, v1::Encounter&);     \
  template WireStatus to_wire<G>(const ChainId&, const WaypointFact<G>&, v1::Waypoint&);       \
  template WireStatus to_wire<G>(const ChainId&, const LivePose<G>&, v1::Pose&);               \
  template WireStatus to_wire<G>(const ChainId&, const AssociationFact&, v1::Association&);    \
  template WireStatus to_wire<G>(const ChainId&, const VerdictFact&, v1::Verdict&);            \
  template WireStatus to_wire<G>(const ChainId&, const Request&, v1::Request&);                \
  template WireStatus to_wire<G>(const ChainId&, const Digest&, v1::Digest&);                  \
  template WireStatus from_wire<G>(const v1::Bias&, Message<G>&);                              \
  template WireStatus from_wire<G>(const v1::Prior&, Message<G>&);                             \
  template WireStatus from_wire<G>(const v1::Association&, Message<G>&);                       \
  template WireStatus from_wire<G>(const v1::Verdict&, Message<G>&);                           \
  template WireStatus from_wire<G>(const v1::AbsoluteFix&, Message<G>&);                       \
  template WireStatus from_wire<G>(const v1::Encounter&, Message<G>&);                         \
  template WireStatus from_wire<G>(const v1::Waypoint&, Message<G>&);                          \
  template WireStatus from_wire<G>(const v1::Pose&, Message<G>&);                              \
  template WireStatus from_wire<G>(const v1::Request&, Message<G>&);                           \
  template WireStatus from_wire<G>(const v1::Digest&, Message<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::dds
