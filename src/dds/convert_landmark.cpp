// Batches of landmarks: nothing is sent that may be left out, and each batch has one form.
#include <convoy/dds/convert_parts.hpp>
#include <convoy/submap/rounding.hpp>

#include <tuple>

namespace convoy::dds {

using namespace parts;

namespace {

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

#define CONVOY_INSTANTIATE(G)                                                                      \
  template WireStatus to_wire<G>(const ChainId&, std::span<const LandmarkFact<G>>, v1::Landmark&); \
  template WireStatus from_wire<G>(const v1::Landmark&, Message<G>&);                              \
  template std::vector<std::span<const LandmarkFact<G>>> split<G>(std::span<const LandmarkFact<G>>);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::dds
