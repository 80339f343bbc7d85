#include <convoy/association/appearance.hpp>
#include <convoy/association/associate.hpp>
#include <convoy/association/strip_index.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace convoy {
namespace {

// Volume of the unit ball in Dim dimensions.
constexpr double unit_ball(int dim) { return dim == 2 ? M_PI : 4.0 / 3.0 * M_PI; }

// The shape of a batch in space: its covariance about the mean, largest eigenvalue 1. A world seen from a vehicle is
// often wide and low, and a ball around a landmark would be mostly sky. No direction counts as thinner than a gate of
// this volume. The identity in the plane.
template <class G>
typename G::PointCovariance shape_of(const Batch<G>& batch, double gate_volume) {
  using Matrix = typename G::PointCovariance;
  if constexpr (G::Dim < 3) return Matrix::Identity();
  typename G::Point mean = G::Point::Zero();
  for (const auto& l : batch.landmarks) mean += l.position / static_cast<double>(batch.landmarks.size());
  Matrix scatter = std::pow(gate_volume / unit_ball(G::Dim), 2.0 / G::Dim) * Matrix::Identity();
  for (const auto& l : batch.landmarks)
    scatter += (l.position - mean) * (l.position - mean).transpose() / static_cast<double>(batch.landmarks.size());
  return scatter / eigenvalues(scatter).maxCoeff();
}

// Probability that a landmark thrown at random among those of `batch` falls within a gate of this volume around one of
// them: the local density, from the distance to the fourth neighbour, averaged over the batch.
template <class G>
double chance_of_a_match(const Batch<G>& batch, double gate_volume) {
  const std::size_t neighbour = std::min<std::size_t>(4, batch.landmarks.size() - 1);
  const Eigen::LLT<typename G::PointCovariance> shape(shape_of(batch, gate_volume));
  const typename G::PointCovariance L = shape.matrixL();
  const double flatness = unit_ball(G::Dim) * L.diagonal().prod();
  double sum = 0.0;
  for (const auto& l : batch.landmarks) {
    std::vector<double> squared;
    for (const auto& other : batch.landmarks)
      squared.push_back(shape.matrixL().solve(other.position - l.position).squaredNorm());
    std::nth_element(squared.begin(), squared.begin() + static_cast<std::ptrdiff_t>(neighbour), squared.end());
    const double ball = flatness * std::pow(std::max(squared[neighbour], 1e-6), 0.5 * G::Dim);
    sum += 1.0 - std::exp(-static_cast<double>(neighbour) / ball * gate_volume);
  }
  return sum / static_cast<double>(batch.landmarks.size());
}

template <class G>
double compatibility_of(const Batch<G>& a, const Batch<G>& b, const AssociationParams& params) {
  return a.anchor.chain == b.anchor.chain ? params.constraints.loop : params.constraints.compatibility;
}

template <class G>
std::vector<Pairing> keys_in(const Batch<G>& a, const Batch<G>& b, const std::vector<IndexPairing>& pairings) {
  std::vector<Pairing> keys;
  for (const auto& [i, j] : pairings)
    keys.emplace_back(a.landmarks[static_cast<std::size_t>(i)].key, b.landmarks[static_cast<std::size_t>(j)].key);
  return canonical(std::move(keys));
}

// One association problem, its stages in order.
template <class G>
class Associator {
 public:
  Associator(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
             const AssociationParams& params, const LooksAlike<G>& looks_alike)
      : a_(a),
        b_(b),
        prior_(prior),
        params_(params),
        looks_alike_(looks_alike),
        compatibility_(compatibility_of(a, b, params)),
        gate_chi2_(chi2_quantile(params.pairing, G::Dim)),
        doubt_chi2_(chi2_quantile(params.residual, G::Dim)) {}

  // A largest set that goes together.
  AssociationResult<G> by_largest_set() {
    find_candidates();
    result_.candidates = candidates_.size();
    if (candidates_.size() > params_.max_candidates) return reject(Rejection::search_cut_off);
    if (static_cast<int>(candidates_.size()) < params_.min_pairings) return reject(Rejection::too_few_candidates);
    const DistanceTable table_a(a_, used_of(a_, &IndexPairing::first)), table_b(b_, used_of(b_, &IndexPairing::second));
    const DistanceCompatibility distance(table_a, table_b, params_.constraints);
    const HeadingCompatibility<G> heading(a_, b_, table_a, table_b, prior_, params_.constraints.heading);
    const auto binary = [&](int i1, int j1, int i2, int j2) {
      return distance(i1, j1, i2, j2) && heading(i1, j1, i2, j2);
    };
    const CompatibilityGraph graph(candidates_, [&](const IndexPairing& p, const IndexPairing& q) {
      return binary(p.first, p.second, q.first, q.second);
    });
    result_.compatible = graph.edges();
    const SearchResult best = search(graph, binary);
    result_.nodes = best.nodes;
    if (best.cut_off) return reject(Rejection::search_cut_off);
    if (!settles(best.pairings)) return result_;
    result_.expected_false_alarms = expected_false_alarms(graph);
    if (result_.expected_false_alarms > params_.max_false_alarms) return reject(Rejection::chance);
    find_runner_up(graph);
    if (repeats_) return ambiguous(Rejection::repeats);
    return has_rival_ ? ambiguous(Rejection::runner_up) : accepted();
  }

  // The likeliest place. a and b are what lies near it.
  AssociationResult<G> by_alignment(const AlignmentSearchResult<G>& found, const std::vector<IndexPairing>& best) {
    result_.nodes = found.votes;
    result_.chance_pairings = found.chance_pairings;
    result_.log_likelihood_ratio = found.candidates.front().log_likelihood_ratio;
    result_.expected_false_alarms = expected_by_chance(found, 0);
    candidates_ = best;
    result_.candidates = best.size();
    if (!settles(best)) return result_;
    if (result_.expected_false_alarms > params_.max_chance_places) return reject(Rejection::chance);
    if (found.candidates.size() > 1) {
      result_.runner_up = static_cast<int>(found.candidates[1].pairings.size());
      result_.runner_up_log_likelihood_ratio = found.candidates[1].log_likelihood_ratio;
      if (expected_by_chance(found, 1) < params_.min_runner_up_false_alarms) return ambiguous(Rejection::repeats);
    }
    const double runner_up = result_.runner_up_log_likelihood_ratio / result_.log_likelihood_ratio;
    const double chance = found.chance_pairings / result_.support;
    if (runner_up + chance <= params_.max_doubt) return accepted();
    return runner_up > chance ? ambiguous(Rejection::runner_up) : reject(Rejection::chance);
  }

 private:
  const LandmarkFact<G>& in_a(int i) const { return a_.landmarks[static_cast<std::size_t>(i)]; }
  const LandmarkFact<G>& in_b(int j) const { return b_.landmarks[static_cast<std::size_t>(j)]; }

  // Places as likely as that one. Markov's inequality: under chance, a ratio of x or more has a probability of at most
  // 1 / x.
  static double expected_by_chance(const AlignmentSearchResult<G>& found, std::size_t place) {
    return static_cast<double>(found.places) * std::exp(-found.candidates[place].log_likelihood_ratio);
  }

  AssociationResult<G> reject(Rejection reason) {
    result_.decision = Decision::none;
    result_.rejection = reason;
    return result_;
  }

  AssociationResult<G> accepted() {
    result_.decision = Decision::accepted;
    return result_;
  }

  AssociationResult<G> ambiguous(Rejection reason) {
    reject(reason);
    result_.decision = Decision::ambiguous;
    return result_;
  }

  // Whether pairings come to an alignment that the prior allows; if not, the reason is given.
  bool settles(const std::vector<IndexPairing>& pairings) {
    result_.pairings = keys_of(pairings);
    if (static_cast<int>(pairings.size()) < params_.min_pairings) reject(Rejection::too_few_pairings);
    else if (!settle(pairings)) reject(Rejection::geometry);
    else if (!fits_prior()) reject(Rejection::prior);
    return result_.rejection == Rejection::not_rejected;
  }

  std::vector<Pairing> keys_of(const std::vector<IndexPairing>& pairings) const { return keys_in(a_, b_, pairings); }

  bool alike(int i, int j) const { return !looks_alike_ || looks_alike_(in_a(i), in_b(j)); }

  void find_candidates() {
    const IndividualCompatibility<G> unary(prior_, compatibility_);
    for (int i = 0; i < static_cast<int>(a_.landmarks.size()); ++i)
      for (int j = 0; j < static_cast<int>(b_.landmarks.size()); ++j)
        if (unary(in_a(i), in_b(j)) && alike(i, j)) candidates_.emplace_back(i, j);
  }

  // Which landmarks of one of the two are part of a candidate.
  std::vector<bool> used_of(const Batch<G>& batch, int IndexPairing::*side) const {
    std::vector<bool> used(batch.landmarks.size(), false);
    for (const IndexPairing& p : candidates_) used[static_cast<std::size_t>(p.*side)] = true;
    return used;
  }

  SearchResult search(const CompatibilityGraph& graph, const std::function<bool(int, int, int, int)>& binary) const {
    if (params_.method != SearchMethod::fig5) return gcbb(graph, params_.max_nodes);
    const IndividualCompatibility<G> unary(prior_, compatibility_);
    SearchResult found = gcbb_literal(
        static_cast<int>(b_.landmarks.size()), static_cast<int>(a_.landmarks.size()),
        [&](int j, int i) { return unary(in_a(i), in_b(j)) && alike(i, j); },
        [&](int j1, int i1, int j2, int i2) { return binary(i1, j1, i2, j2); }, params_.max_nodes);
    for (auto& [i, j] : found.pairings) std::swap(i, j);
    std::sort(found.pairings.begin(), found.pairings.end());
    return found;
  }

  // Aligns, takes every pair that agrees with the alignment (each landmark once, best first), until nothing changes.
  bool settle(std::vector<IndexPairing> pairings) {
    for (int round = 0; round < 5; ++round) {
      const auto alignment = align(a_, b_, pairings);
      if (!alignment) return false;
      const std::vector<IndexPairing> agreeing = pairs_agreeing_with(*alignment);
      if (static_cast<int>(agreeing.size()) < params_.min_pairings) return false;
      if (agreeing == pairings) break;
      pairings = agreeing;
    }
    const auto whole = align(a_, b_, pairings);
    if (!whole) return false;
    pairings = without_doubtful(*whole, pairings);
    if (static_cast<int>(pairings.size()) < params_.min_pairings) return false;
    const auto alignment = align(a_, b_, pairings);
    return alignment && keep(*alignment, pairings);
  }

  // Leaves out pairings that could as well be others, where things stand side by side.
  std::vector<IndexPairing> without_doubtful(const Alignment<G>& alignment, const std::vector<IndexPairing>& pairings) {
    result_.nodes += pairings.size() * pairings.size();
    std::vector<IndexPairing> kept;
    for (const IndexPairing& p : pairings)
      if (!doubtful(alignment, pairings, p)) kept.push_back(p);
    return kept;
  }

  // A neighbourhood may be shifted as a whole, so alternatives are looked for with what lies farther away. If one is
  // not paired otherwise, nothing tells it from p; if it is, exchanging the two must be much worse than leaving them.
  bool doubtful(const Alignment<G>& alignment, const std::vector<IndexPairing>& pairings, const IndexPairing& p) const {
    std::vector<IndexPairing> far;
    for (const IndexPairing& q : pairings)
      if (!near(in_a(p.first), in_a(q.first))) far.push_back(q);
    const auto outside = align(a_, b_, far);
    if (!outside) return true;
    const double margin = chi2_quantile(params_.separation, G::Dim);
    const double spread = log_volume(*outside, p.first, p.second);
    const auto confusable = [&](int i, int j) {
      const double chi2 = residual_chi2(*outside, in_a(i), in_b(j));
      return chi2 < doubt_chi2_ && chi2 + log_volume(*outside, i, j) < doubt_chi2_ + spread;
    };
    const auto fit = [&](int i, int j) { return surprise(alignment, i, j); };
    std::vector<bool> paired_a(a_.landmarks.size(), false), paired_b(b_.landmarks.size(), false);
    for (const auto& [i, j] : pairings)
      paired_a[static_cast<std::size_t>(i)] = paired_b[static_cast<std::size_t>(j)] = true;
    for (int i = 0; i < static_cast<int>(a_.landmarks.size()); ++i)
      if (!paired_a[static_cast<std::size_t>(i)] && confusable(i, p.second)) return true;
    for (int j = 0; j < static_cast<int>(b_.landmarks.size()); ++j)
      if (!paired_b[static_cast<std::size_t>(j)] && confusable(p.first, j)) return true;
    for (const IndexPairing& q : pairings) {
      if (q == p || !(confusable(p.first, q.second) || confusable(q.first, p.second))) continue;
      const double exchanged = fit(p.first, q.second) + fit(q.first, p.second);
      if (exchanged < fit(p.first, p.second) + fit(q.first, q.second) + margin) return true;
    }
    return false;
  }

  // ln det of what a residual may be by its covariance.
  double log_volume(const Alignment<G>& alignment, int i, int j) const {
    return std::log(residual_covariance(alignment, in_a(i), in_b(j)).determinant());
  }

  // -2 ln of the likelihood of a pair, but for a constant. By chi-square alone what is hardly known would fit best.
  double surprise(const Alignment<G>& alignment, int i, int j) const {
    return residual_chi2(alignment, in_a(i), in_b(j)) + log_volume(alignment, i, j);
  }

  // Too close for their own covariances to tell them apart.
  bool near(const LandmarkFact<G>& l, const LandmarkFact<G>& m) const {
    return squared_mahalanobis(typename G::Point(l.position - m.position),
                               typename G::PointCovariance(l.covariance + m.covariance)) < doubt_chi2_;
  }

  bool keep(const Alignment<G>& alignment, const std::vector<IndexPairing>& pairings) {
    result_.alignment = alignment;
    result_.support = static_cast<int>(pairings.size());
    settled_ = pairings;
    result_.pairings = keys_of(pairings);
    return alignment.chi2 <= chi2_quantile(params_.residual, alignment.dof);
  }

  std::vector<IndexPairing> pairs_agreeing_with(const Alignment<G>& alignment) const {
    struct Scored {
      double surprise;
      IndexPairing pairing;
      auto operator<=>(const Scored&) const = default;
    };
    std::vector<Scored> scored;
    for (const auto& [i, j] : candidates_) {
      const double chi2 = residual_chi2(alignment, in_a(i), in_b(j));
      if (chi2 < gate_chi2_) scored.push_back({chi2 + log_volume(alignment, i, j), {i, j}});
    }
    std::sort(scored.begin(), scored.end());
    std::vector<bool> used_a(a_.landmarks.size(), false), used_b(b_.landmarks.size(), false);
    std::vector<IndexPairing> pairings;
    for (const auto& [surprise, pairing] : scored) {
      auto&& ua = used_a[static_cast<std::size_t>(pairing.first)];
      auto&& ub = used_b[static_cast<std::size_t>(pairing.second)];
      if (ua || ub) continue;
      ua = ub = true;
      pairings.push_back(pairing);
    }
    std::sort(pairings.begin(), pairings.end());
    return pairings;
  }

  bool fits_prior() const {
    if (!prior_) return true;
    const typename G::Tangent r = (prior_->mean.inverse() * result_.alignment.T_a_b).Log();
    return squared_mahalanobis(r, typename G::Covariance(prior_->covariance + result_.alignment.covariance())) <
           chi2_quantile(compatibility_, G::Dof);
  }

  // Every compatible pair of pairings (three in space) proposes one alignment; each other landmark agrees with it by
  // chance with probability q. The expected number of alignments with as much support as ours, all of them chance:
  double expected_false_alarms(const CompatibilityGraph& graph) const {
    const std::uint64_t proposals = G::Dim == 2 ? graph.edges() : graph.triangles();
    double volume = 0.0;
    for (const auto& [i, j] : settled_)
      volume += unit_ball(G::Dim) * std::pow(gate_chi2_, 0.5 * G::Dim) *
                std::sqrt(residual_covariance(result_.alignment, in_a(i), in_b(j)).determinant());
    const double q = chance_of_a_match(a_, volume / static_cast<double>(settled_.size()));
    const int others = static_cast<int>(std::min(a_.landmarks.size(), b_.landmarks.size())) - G::Dim;
    return static_cast<double>(proposals) * binomial_tail(others, q, result_.support - G::Dim);
  }

  // The best alignment made of pairings that disagree with ours: a rival if it comes near ours, or is no chance.
  void find_runner_up(const CompatibilityGraph& graph) {
    const double apart = chi2_quantile(0.9999, G::Dim);
    const CompatibilityGraph rest = graph.without(
        [&](const IndexPairing& p) { return residual_chi2(result_.alignment, in_a(p.first), in_b(p.second)) < apart; });
    const SearchResult second = gcbb(rest, params_.max_nodes);
    has_rival_ = second.cut_off;  // not known: nothing may be assumed
    Associator other(a_, b_, prior_, params_, looks_alike_);
    other.candidates_ = candidates_;
    const bool aligned =
        static_cast<int>(second.pairings.size()) >= params_.min_pairings && other.settle(second.pairings);
    if (second.cut_off || !aligned || !other.fits_prior()) return;
    result_.runner_up = other.result_.support;
    has_rival_ = result_.runner_up > params_.max_runner_up_share * result_.support;
    repeats_ = other.expected_false_alarms(graph) < params_.min_runner_up_false_alarms;
    if (has_rival_ || repeats_) result_.runner_up_pairings = std::move(other.result_.pairings);
  }

  const Batch<G>& a_;
  const Batch<G>& b_;
  const std::optional<RelativePrior<G>>& prior_;
  const AssociationParams& params_;
  const LooksAlike<G>& looks_alike_;
  double compatibility_;
  double gate_chi2_, doubt_chi2_;
  std::vector<IndexPairing> candidates_;  // that may be paired
  std::vector<IndexPairing> settled_;
  bool has_rival_ = false, repeats_ = false;
  AssociationResult<G> result_;
};

// What lies within reach of an alignment, so that everything after the search is small however large the map is; the
// drift within b, as seen from the middle of what is paired, is part of its noise from here on.
template <class G>
struct Vicinity {
  Vicinity(const Batch<G>& whole_a, const Batch<G>& whole_b, const CandidateAlignment<G>& place)
      : a{whole_a.anchor, {}}, b(whole_b), pairings(place.pairings) {
    constexpr double reach_m = 8.0;
    StripIndex near_b(reach_m);
    Eigen::AlignedBox2d box;
    for (const auto& l : b.landmarks) {
      const Eigen::Vector2d at = (place.T_a_b * l.position).template head<2>();
      near_b.add(at, 0);
      box.extend(at);
    }
    near_b.sort();
    const Eigen::Vector2d margin = Eigen::Vector2d::Constant(reach_m);
    box = {box.min() - margin, box.max() + margin};
    // What is paired is near however far away it is: an uncertain landmark may agree from anywhere.
    std::vector<bool> paired(whole_a.landmarks.size(), false);
    for (const auto& [i, j] : place.pairings) paired[static_cast<std::size_t>(i)] = true;
    std::vector<int> number(whole_a.landmarks.size(), -1);
    for (std::size_t i = 0; i < number.size(); ++i) {
      const Eigen::Vector2d at = whole_a.landmarks[i].position.template head<2>();
      bool near = paired[i];
      if (!near && box.contains(at)) near_b.each_near(at, reach_m, [&](int) { near = true; });
      if (!near) continue;
      number[i] = static_cast<int>(a.landmarks.size());
      a.landmarks.push_back(whole_a.landmarks[i]);
    }
    for (auto& [i, j] : pairings) i = number[static_cast<std::size_t>(i)];
    if (b.drift_m2_per_m > 0.0 && !pairings.empty()) add_drift();
  }
  Batch<G> a, b;
  std::vector<IndexPairing> pairings;  // of the place, in these batches

 private:
  void add_drift() {
    double middle_m = 0.0;
    for (const auto& [i, j] : pairings)
      middle_m += b.abscissa_m[static_cast<std::size_t>(j)] / static_cast<double>(pairings.size());
    for (std::size_t j = 0; j < b.landmarks.size(); ++j)
      b.landmarks[j].covariance.diagonal().array() += b.drift_m2_per_m * std::abs(b.abscissa_m[j] - middle_m);
  }
};

template <class G>
AssociationResult<G> by_alignment(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                                  const AssociationParams& params, const LooksAlike<G>& looks_alike) {
  const auto found = find_alignments(a, b, prior, compatibility_of(a, b, params), params.alignment, looks_alike);
  if (found.candidates.empty()) {
    AssociationResult<G> none;
    none.nodes = found.votes;
    none.rejection = found.cut_off                                                   ? Rejection::search_cut_off
                     : found.votes < static_cast<std::uint64_t>(params.min_pairings) ? Rejection::too_few_candidates
                                                                                     : Rejection::too_few_pairings;
    return none;
  }
  const Vicinity<G> vicinity(a, b, found.candidates.front());
  auto result =
      Associator<G>(vicinity.a, vicinity.b, prior, params, looks_alike).by_alignment(found, vicinity.pairings);
  // A second place of too few pairings cannot be stated, and the first without it would pass for sure: then neither is.
  if (result.decision == Decision::ambiguous && result.runner_up >= params.min_pairings)
    result.runner_up_pairings = keys_in(a, b, found.candidates[1].pairings);
  return result;
}

template <class G>
bool is_fit(const Batch<G>& batch) {
  const bool placed =
      batch.abscissa_m.size() == batch.landmarks.size() || (batch.abscissa_m.empty() && batch.drift_m2_per_m == 0.0);
  return placed && std::all_of(batch.landmarks.begin(), batch.landmarks.end(), [](const LandmarkFact<G>& l) {
           return l.position.allFinite() && l.loading.allFinite() && is_covariance(l.covariance) &&
                  is_covariance(l.own_covariance(), l.covariance.trace());
         });
}

template <class G>
bool is_fit(const std::optional<RelativePrior<G>>& prior) {
  return !prior || (prior->mean.rotation().allFinite() && prior->mean.translation().allFinite() &&
                    is_covariance(prior->covariance));
}

// Without what is ten times less certain than most (and than 5 cm): it agrees with anything and says nothing. Empty if
// there is none.
template <class G>
std::optional<Batch<G>> without_loose(const Batch<G>& batch) {
  const auto variance_m2 = [](const LandmarkFact<G>& l) { return l.covariance.trace() / G::Dim; };
  std::vector<double> all;
  for (const auto& l : batch.landmarks) all.push_back(variance_m2(l));
  const auto middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
  std::nth_element(all.begin(), middle, all.end());
  const double most_m2 = 100.0 * std::max(0.05 * 0.05, *middle);
  if (std::none_of(all.begin(), all.end(), [&](double x) { return x > most_m2; })) return std::nullopt;
  Batch<G> kept{batch.anchor, {}, {}, batch.drift_m2_per_m};
  for (std::size_t k = 0; k < batch.landmarks.size(); ++k) {
    if (variance_m2(batch.landmarks[k]) > most_m2) continue;
    kept.landmarks.push_back(batch.landmarks[k]);
    if (!batch.abscissa_m.empty()) kept.abscissa_m.push_back(batch.abscissa_m[k]);
  }
  return kept;
}

template <class G>
AssociationResult<G> refused(Rejection reason) {
  AssociationResult<G> result;
  result.rejection = reason;
  return result;
}

template <class G>
LooksAlike<G> both(const LooksAlike<G>& first, const LooksAlike<G>& second) {
  if (!first || !second) return first ? first : second;
  return [first, second](const LandmarkFact<G>& i, const LandmarkFact<G>& j) { return first(i, j) && second(i, j); };
}

}  // namespace

void validate(const AssociationParams& p) {
  const auto share = [](double x) { return x > 0.0 && x < 1.0; };
  if (!share(p.constraints.compatibility) || !share(p.constraints.loop) || !share(p.constraints.distance) ||
      !share(p.constraints.heading) || !share(p.residual) || !share(p.pairing) || !share(p.separation))
    throw ConfigError("association: confidences must lie in (0, 1)");
  if (!(p.constraints.min_distance_m >= 0.0)) throw ConfigError("association: min_distance_m must be >= 0");
  if (p.min_pairings < 3) throw ConfigError("association: min_pairings must be >= 3; two pairs align with anything");
  if (!(p.max_false_alarms > 0.0)) throw ConfigError("association: max_false_alarms must be > 0");
  if (!(p.max_runner_up_share > 0.0 && p.max_runner_up_share <= 1.0))
    throw ConfigError("association: max_runner_up_share must lie in (0, 1]");
  if (!(p.min_runner_up_false_alarms >= p.max_false_alarms))
    throw ConfigError("association: min_runner_up_false_alarms must be >= max_false_alarms");
  if (!(p.min_similarity >= -1.0 && p.min_similarity <= 1.0))
    throw ConfigError("association: min_similarity must lie in [-1, 1]");
  if (p.max_candidates == 0 || p.max_landmarks == 0)
    throw ConfigError("association: max_candidates and max_landmarks must be > 0");
  if (p.max_nodes == 0) throw ConfigError("association: max_nodes must be > 0");
  if (!(p.max_chance_places > 0.0)) throw ConfigError("association: max_chance_places must be > 0");
  if (!(p.max_doubt > 0.0 && p.max_doubt <= 1.0)) throw ConfigError("association: max_doubt must lie in (0, 1]");
  validate(p.alignment);
}

const char* to_string(SearchMethod method) {
  switch (method) {
    case SearchMethod::alignment: return "alignment";
    case SearchMethod::gcbb: return "gcbb";
    case SearchMethod::fig5: return "fig5";
  }
  return "unknown";
}

const char* to_string(Decision decision) {
  switch (decision) {
    case Decision::accepted: return "accepted";
    case Decision::none: return "none";
    case Decision::ambiguous: return "ambiguous";
  }
  return "unknown";
}

const char* to_string(Rejection rejection) {
  switch (rejection) {
    case Rejection::not_rejected: return "not_rejected";
    case Rejection::too_few_candidates: return "too_few_candidates";
    case Rejection::too_few_pairings: return "too_few_pairings";
    case Rejection::search_cut_off: return "search_cut_off";
    case Rejection::geometry: return "geometry";
    case Rejection::prior: return "prior";
    case Rejection::chance: return "chance";
    case Rejection::runner_up: return "runner_up";
    case Rejection::repeats: return "repeats";
    case Rejection::unfit: return "unfit";
  }
  return "unknown";
}

template <class G>
std::vector<std::vector<Pairing>> AssociationResult<G>::statements() const {
  if (decision == Decision::accepted) return {pairings};
  if (decision == Decision::ambiguous && !runner_up_pairings.empty()) return {pairings, runner_up_pairings};
  return {};
}

template <class G>
AssociationResult<G> associate(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                               const AssociationParams& params, const LooksAlike<G>& looks_alike) {
  const auto enough = static_cast<std::size_t>(params.min_pairings);
  const auto is_small = [&](const Batch<G>& batch) { return batch.landmarks.size() < enough; };
  if (is_small(a) || is_small(b)) return refused<G>(Rejection::too_few_candidates);
  if (!is_fit(a) || !is_fit(b) || !is_fit(prior)) return refused<G>(Rejection::unfit);
  if (const auto less = without_loose(a)) return associate(*less, b, prior, params, looks_alike);
  if (const auto less = without_loose(b)) return associate(a, *less, prior, params, looks_alike);
  const LooksAlike<G> alike = both<G>(alike_by_appearance(a, b, params.min_similarity), looks_alike);
  if (params.method == SearchMethod::alignment && has_level(prior)) return by_alignment(a, b, prior, params, alike);
  return Associator<G>(a, b, prior, params, alike).by_largest_set();
}

#define CONVOY_INSTANTIATE(G)                                                                                       \
  template struct AssociationResult<G>;                                                                             \
  template AssociationResult<G> associate(const Batch<G>&, const Batch<G>&, const std::optional<RelativePrior<G>>&, \
                                          const AssociationParams&, const LooksAlike<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
