#include <convoy/dds/convert.hpp>
#include <convoy/dds/wire_bounds.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/rounding.hpp>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <tuple>

namespace convoy::dds {
namespace {

// ---- group elements --------------------------------------------------------------------------------------------

std::vector<double> coordinates(const SE2& T) { return {T.translation().x(), T.translation().y(), T.theta()}; }
std::vector<double> coordinates(const SE3& T) {
  const SE3::Point& t = T.translation();
  const SE3::Quaternion& q = T.quaternion();
  return {t.x(), t.y(), t.z(), q[0], q[1], q[2], q[3]};
}

bool all_finite(const std::vector<double>& c) {
  return std::all_of(c.begin(), c.end(), [](double value) { return std::isfinite(value); });
}

WireStatus from_coordinates(const std::vector<double>& c, SE2& T) {
  if (c.size() != 3) return WireStatus::wrong_size;
  if (!all_finite(c)) return WireStatus::not_finite;
  // The content hash of a fact covers the angle as stored: an angle that would be wrapped here was not written by us.
  if (wrap_angle(c[2]) != c[2]) return WireStatus::out_of_range;
  T = SE2(c[0], c[1], c[2]);
  return WireStatus::ok;
}
WireStatus from_coordinates(const std::vector<double>& c, SE3& T) {
  if (c.size() != 7) return WireStatus::wrong_size;
  if (!all_finite(c)) return WireStatus::not_finite;
  const SE3::Quaternion q(c[3], c[4], c[5], c[6]);
  T = SE3(q, {c[0], c[1], c[2]});
  // For the same reason: a quaternion that is not of length one, or -q for q, was not written by us.
  return T.quaternion() == q ? WireStatus::ok : WireStatus::out_of_range;
}

// ---- small parts -----------------------------------------------------------------------------------------------

template <class Matrix>
WireStatus pack(const Matrix& P, std::vector<double>& out) {
  out.clear();
  out.reserve(static_cast<std::size_t>(P.rows() * (P.rows() + 1) / 2));
  for (Eigen::Index r = 0; r < P.rows(); ++r)
    for (Eigen::Index c = r; c < P.cols(); ++c) {
      if (P(r, c) != P(c, r)) return std::isfinite(P(r, c)) ? WireStatus::not_symmetric : WireStatus::not_finite;
      out.push_back(P(r, c));
    }
  return WireStatus::ok;
}

template <class Matrix>
WireStatus unpack(const std::vector<double>& in, Matrix& P) {
  if (in.size() != static_cast<std::size_t>(P.rows() * (P.rows() + 1) / 2)) return WireStatus::wrong_size;
  auto next = in.begin();
  for (Eigen::Index r = 0; r < P.rows(); ++r)
    for (Eigen::Index c = r; c < P.cols(); ++c) {
      if (!std::isfinite(*next)) return WireStatus::not_finite;
      P(r, c) = P(c, r) = *next++;
    }
  return WireStatus::ok;
}

template <class Point>
WireStatus from_wire_vector(const std::vector<double>& in, Point& point) {
  if (in.size() != static_cast<std::size_t>(point.size())) return WireStatus::wrong_size;
  std::copy(in.begin(), in.end(), point.data());
  return point.allFinite() ? WireStatus::ok : WireStatus::not_finite;
}

/// Nothing stands for zero.
template <class Vector>
std::vector<double> to_wire_unless_zero(const Vector& v) {
  return v.isZero(0.0) ? std::vector<double>() : std::vector<double>(v.data(), v.data() + v.size());
}

template <class Vector>
WireStatus from_wire_vector_or_zero(const std::vector<double>& in, Vector& v) {
  v.setZero();
  return in.empty() ? WireStatus::ok : from_wire_vector(in, v);
}

v1::Chain wire_chain(const ChainId& chain) {
  v1::Chain out;
  out.epoch(chain.epoch);
  out.vehicle(chain.vehicle);
  return out;
}

ChainId core_chain(const v1::Chain& chain) { return {chain.vehicle(), chain.epoch()}; }

template <class Sample>
ChainId author(const Sample& sample) {
  return {sample.vehicle(), sample.epoch()};
}

template <class Sample>
void set_author(const ChainId& chain, Sample& sample) {
  sample.vehicle(chain.vehicle);
  sample.epoch(chain.epoch);
}

template <class Sample>
void set_key(const ChainId& sender, const Key& key, Sample& sample) {
  sample.sender(wire_chain(sender));
  set_author(key.chain, sample);
  sample.index(key.index);
}

/// Sender and author are somebody.
template <class Sample>
WireStatus check_names(const Sample& sample) {
  return sample.sender().vehicle() != 0 && sample.vehicle() != 0 ? WireStatus::ok : WireStatus::out_of_range;
}

template <class G, class Sample>
WireStatus check_dimension(const Sample& sample) {
  return sample.dimension() == G::Dim ? WireStatus::ok : WireStatus::wrong_dimension;
}

template <class... Rest>
WireStatus first_refusal(WireStatus first, Rest... rest) {
  if constexpr (sizeof...(rest) == 0) return first;
  else return first != WireStatus::ok ? first : first_refusal(rest...);
}

template <class G>
WireStatus to_wire_state(const ChainState<G>& state, v1::ChainState& out) {
  out.stamp_s(state.stamp_s);
  out.abscissa_m(state.abscissa_m);
  out.pose(coordinates(state.pose));
  out.heading_lever(to_wire_unless_zero(state.heading_lever));
  return pack(state.drift, out.drift());
}

template <class G>
WireStatus from_wire_state(const v1::ChainState& in, ChainState<G>& state) {
  if (!std::isfinite(in.stamp_s()) || !std::isfinite(in.abscissa_m())) return WireStatus::not_finite;
  state.stamp_s = in.stamp_s();
  state.abscissa_m = in.abscissa_m();
  return first_refusal(from_coordinates(in.pose(), state.pose), unpack(in.drift(), state.drift),
                       from_wire_vector_or_zero(in.heading_lever(), state.heading_lever));
}

// The core's enums and the wire's have the same numbers.
static_assert(v1::KIND_ABSOLUTE_FIX == static_cast<std::uint32_t>(FactKind::absolute_fix));
static_assert(v1::KIND_ENCOUNTER == static_cast<std::uint32_t>(FactKind::encounter));
static_assert(v1::KIND_WAYPOINT == static_cast<std::uint32_t>(FactKind::waypoint));
static_assert(fact_kind_count == static_cast<int>(bounds::kinds));
static_assert(v1::INTEGRITY_SUSPECT == static_cast<std::uint32_t>(Integrity::suspect));
static_assert(v1::DESCRIPTOR_PATCH_8X8_4BIT == static_cast<std::uint32_t>(Descriptor::Kind::patch_8x8_4bit));

template <class To, class From>
WireStatus convert_enum(From from, From last, To& to) {
  if (static_cast<std::uint32_t>(from) > static_cast<std::uint32_t>(last)) return WireStatus::unknown_enum;
  to = static_cast<To>(from);
  return WireStatus::ok;
}

// ---- landmarks -------------------------------------------------------------------------------------------------

constexpr std::size_t descriptor_bytes = std::tuple_size_v<decltype(Descriptor::bytes)>;
static_assert(descriptor_bytes * bounds::landmarks == bounds::descriptors);

bool is_none(const Descriptor& descriptor) { return descriptor.kind == Descriptor::Kind::none; }

/// Bytes of the loading of one landmark of which so many columns are sent.
template <class G>
constexpr std::size_t loading_bytes(std::size_t columns) {
  return columns == 0 ? 0 : 1 + (columns + 1) / 2 + columns * G::Dim;
}
static_assert(loading_bytes<SE2>(SE2::Shared) * bounds::landmarks <= bounds::loadings);
static_assert(loading_bytes<SE3>(SE3::Shared) * bounds::landmarks <= bounds::loadings);

/// What decides how long the sequences of a sample are.
template <class G>
struct Extent {
  static constexpr std::size_t dim = G::Dim, packed = dim * (dim + 1) / 2;
  std::size_t landmarks = 0, described = 0, columns = 0;
  bool kinds = false;

  void add(const LandmarkFact<G>& fact) {
    ++landmarks;
    described += !is_none(fact.descriptor);
    kinds = kinds || fact.kind != 0;
    columns = std::max(columns, columns_of<G>(fact.loading));
  }
  /// The size of the sample, serialised.
  std::size_t bytes() const {
    constexpr std::size_t header = 40, lengths = 7 * 4;
    const std::size_t octets = (landmarks + 3) / 4 * 4;  // as the next length is aligned
    return header + lengths + 4 * landmarks * (1 + dim + packed) + (kinds ? octets : 0) + (described > 0 ? octets : 0) +
           described * descriptor_bytes + landmarks * loading_bytes<G>(columns);
  }
};

template <class G>
void append_loading(const BlockLoading<G>& block, std::size_t columns, std::vector<std::uint8_t>& out) {
  if (columns == 0) return;
  out.push_back(block.exponent);
  for (std::size_t k = 0; k < columns; k += 2) {
    const unsigned second = k + 1 < columns ? block.shift[k + 1] : 0U;
    out.push_back(static_cast<std::uint8_t>(block.shift[k] | second << 4U));
  }
  for (std::size_t i = 0; i < columns * block.rows; ++i) out.push_back(static_cast<std::uint8_t>(block.mantissa[i]));
}

/// `in`: loading_bytes() of them.
template <class G>
BlockLoading<G> block_from(const std::uint8_t* in, std::size_t columns) {
  BlockLoading<G> block;
  if (columns == 0) return block;
  block.exponent = *in++;
  for (std::size_t k = 0; k < columns; k += 2) {
    block.shift[k] = *in & 15U;
    if (k + 1 < columns) block.shift[k + 1] = static_cast<std::uint8_t>(*in >> 4U);
    ++in;
  }
  for (std::size_t i = 0; i < columns * block.rows; ++i) block.mantissa[i] = static_cast<std::int8_t>(in[i]);
  return block;
}

template <class G>
void append_landmark(const LandmarkFact<G>& fact, const Extent<G>& extent, v1::Landmark& sample) {
  sample.index().push_back(fact.key.index);
  if (extent.kinds) sample.kind().push_back(fact.kind);
  if (extent.described > 0) sample.descriptor_kind().push_back(static_cast<std::uint8_t>(fact.descriptor.kind));
  const auto& bytes = fact.descriptor.bytes;
  if (!is_none(fact.descriptor)) sample.descriptor().insert(sample.descriptor().end(), bytes.begin(), bytes.end());
  for (Eigen::Index r = 0; r < G::Dim; ++r) sample.position().push_back(static_cast<float>(fact.position[r]));
  for (Eigen::Index r = 0; r < G::Dim; ++r)
    for (Eigen::Index c = r; c < G::Dim; ++c) sample.covariance().push_back(static_cast<float>(fact.covariance(r, c)));
  append_loading(*block_loading<G>(fact.loading), extent.columns, sample.loading());
}

/// What a sample says of itself, if all of its sequences agree on it.
template <class G>
WireStatus extent_of(const v1::Landmark& sample, Extent<G>& extent) {
  const std::size_t n = extent.landmarks = sample.index().size();
  if (n == 0) return WireStatus::out_of_range;
  if (n > bounds::landmarks) return WireStatus::too_many;
  const auto n_or_none = [n](std::size_t size) { return size == 0 || size == n; };
  const auto& kinds = sample.descriptor_kind();
  extent.described = kinds.size() - static_cast<std::size_t>(std::count(kinds.begin(), kinds.end(), 0));
  while (extent.columns < G::Shared && n * loading_bytes<G>(extent.columns) < sample.loading().size()) ++extent.columns;
  const bool agree = n_or_none(sample.kind().size()) && n_or_none(kinds.size()) &&
                     sample.descriptor().size() == extent.described * descriptor_bytes &&
                     sample.position().size() == n * extent.dim && sample.covariance().size() == n * extent.packed &&
                     sample.loading().size() == n * loading_bytes<G>(extent.columns);
  return agree ? WireStatus::ok : WireStatus::wrong_size;
}

/// Number `i` of a sample whose sequences agree. `described`: how many before it have a descriptor; counted on.
template <class G>
WireStatus read_landmark(const v1::Landmark& sample, const Extent<G>& extent, std::size_t i, std::size_t& described,
                         LandmarkFact<G>& fact) {
  fact.key = {author(sample), sample.index()[i]};
  fact.anchor = sample.anchor();
  if (!sample.kind().empty()) fact.kind = sample.kind()[i];
  if (!sample.descriptor_kind().empty()) {
    const auto kind = static_cast<v1::DescriptorKind>(sample.descriptor_kind()[i]);
    const WireStatus status = convert_enum(kind, v1::DESCRIPTOR_PATCH_8X8_4BIT, fact.descriptor.kind);
    if (status != WireStatus::ok) return status;
  }
  if (!is_none(fact.descriptor))
    std::copy_n(sample.descriptor().data() + descriptor_bytes * described++, descriptor_bytes,
                fact.descriptor.bytes.begin());
  std::copy_n(sample.position().data() + extent.dim * i, extent.dim, fact.position.data());
  const float* covariance = sample.covariance().data() + extent.packed * i;
  fact.loading =
      loading_of(block_from<G>(sample.loading().data() + loading_bytes<G>(extent.columns) * i, extent.columns));
  return first_refusal(fact.position.allFinite() ? WireStatus::ok : WireStatus::not_finite,
                       unpack(std::vector<double>(covariance, covariance + extent.packed), fact.covariance));
}

}  // namespace

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

// ---- landmarks -------------------------------------------------------------------------------------------------

template <class G>
std::vector<std::span<const LandmarkFact<G>>> split(std::span<const LandmarkFact<G>> batch) {
  std::vector<std::span<const LandmarkFact<G>>> parts;
  for (std::size_t first = 0; first < batch.size();) {
    std::size_t n = 0;
    Extent<G> extent;
    while (first + n < batch.size() && n < bounds::landmarks &&
           batch[first + n].anchor_key() == batch[first].anchor_key()) {
      extent.add(batch[first + n]);
      if (n > 0 && extent.bytes() > max_sample_bytes) break;
      ++n;
    }
    parts.push_back(batch.subspan(first, n));
    first += n;
  }
  return parts;
}

template <class G>
WireStatus to_wire(const ChainId& sender, std::span<const LandmarkFact<G>> batch, v1::Landmark& sample) {
  if (batch.empty()) return WireStatus::out_of_range;
  if (batch.size() > bounds::landmarks) return WireStatus::too_many;
  Extent<G> extent;
  for (const LandmarkFact<G>& fact : batch) {
    if (fact.anchor_key() != batch.front().anchor_key()) return WireStatus::out_of_range;
    if (!is_rounded(fact)) return WireStatus::not_rounded;
    extent.add(fact);
  }
  sample = {};
  sample.sender(wire_chain(sender));
  set_author(batch.front().key.chain, sample);
  sample.anchor(batch.front().anchor);
  sample.dimension(G::Dim);
  for (const LandmarkFact<G>& fact : batch) append_landmark(fact, extent, sample);
  return WireStatus::ok;
}

template <class G>
WireStatus from_wire(const v1::Landmark& sample, Message<G>& message) {
  Extent<G> extent;
  const WireStatus status =
      first_refusal(check_names(sample), check_dimension<G>(sample), extent_of<G>(sample, extent));
  if (status != WireStatus::ok) return status;
  LandmarkBatch<G> batch;
  batch.landmarks.resize(extent.landmarks);
  std::size_t described = 0;
  for (std::size_t i = 0; i < extent.landmarks; ++i) {
    const WireStatus landmark = read_landmark(sample, extent, i, described, batch.landmarks[i]);
    if (landmark != WireStatus::ok) return landmark;
  }
  // A landmark has one form; what has another was not written by us.
  v1::Landmark again;
  const bool same = to_wire(core_chain(sample.sender()), std::span<const LandmarkFact<G>>(batch.landmarks), again) ==
                        WireStatus::ok &&
                    again == sample;
  message = {core_chain(sample.sender()), std::move(batch)};
  return same ? WireStatus::ok : WireStatus::not_canonical;
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

#define CONVOY_INSTANTIATE(G)                                                                      \
  template WireStatus to_wire<G>(const ChainId&, const AnchorFact<G>&, v1::Bias&);                 \
  template WireStatus to_wire<G>(const ChainId&, std::span<const LandmarkFact<G>>, v1::Landmark&); \
  template WireStatus to_wire<G>(const ChainId&, const PriorFact<G>&, v1::Prior&);                 \
  template WireStatus to_wire<G>(const ChainId&, const AbsoluteFixFact<G>&, v1::AbsoluteFix&);     \
  template WireStatus to_wire<G>(const ChainId&, const EncounterFact<G>&, v1::Encounter&);         \
  template WireStatus to_wire<G>(const ChainId&, const WaypointFact<G>&, v1::Waypoint&);           \
  template WireStatus to_wire<G>(const ChainId&, const LivePose<G>&, v1::Pose&);                   \
  template WireStatus to_wire<G>(const ChainId&, const AssociationFact&, v1::Association&);        \
  template WireStatus to_wire<G>(const ChainId&, const VerdictFact&, v1::Verdict&);                \
  template WireStatus to_wire<G>(const ChainId&, const Request&, v1::Request&);                    \
  template WireStatus to_wire<G>(const ChainId&, const Digest&, v1::Digest&);                      \
  template WireStatus from_wire<G>(const v1::Bias&, Message<G>&);                                  \
  template WireStatus from_wire<G>(const v1::Landmark&, Message<G>&);                              \
  template WireStatus from_wire<G>(const v1::Prior&, Message<G>&);                                 \
  template WireStatus from_wire<G>(const v1::Association&, Message<G>&);                           \
  template WireStatus from_wire<G>(const v1::Verdict&, Message<G>&);                               \
  template WireStatus from_wire<G>(const v1::AbsoluteFix&, Message<G>&);                           \
  template WireStatus from_wire<G>(const v1::Encounter&, Message<G>&);                             \
  template WireStatus from_wire<G>(const v1::Waypoint&, Message<G>&);                              \
  template WireStatus from_wire<G>(const v1::Pose&, Message<G>&);                                  \
  template WireStatus from_wire<G>(const v1::Request&, Message<G>&);                               \
  template WireStatus from_wire<G>(const v1::Digest&, Message<G>&);                                \
  template std::vector<std::span<const LandmarkFact<G>>> split<G>(std::span<const LandmarkFact<G>>);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::dds
