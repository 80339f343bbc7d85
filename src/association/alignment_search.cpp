#include <convoy/association/alignment_search.hpp>
#include <convoy/association/strip_index.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <bit>
#include <cmath>
#include <iterator>
#include <limits>
#include <optional>
#include <tuple>

namespace convoy {
namespace {

constexpr double max_tilt_rad = 0.1;

// A shift in steps; z is 0 in the plane.
struct Step {
  int x = 0, y = 0, z = 0;
  auto operator<=>(const Step&) const = default;
};

// Votes of one heading, by block of shifts: each voter counts once per block, with its heaviest vote.
class Ballot {
 public:
  void add(const Step& at, int voter, double weight) {
    if (2 * used_.size() >= blocks_.size()) grow();
    Block& s = blocks_[find(at)];
    if (s.voter == voter) {
      s.score += std::max(0.0, weight - s.heaviest);
      s.heaviest = std::max(s.heaviest, weight);
      return;
    }
    if (s.voter == nobody) {
      s.at = at;
      used_.push_back(static_cast<std::size_t>(&s - blocks_.data()));
    }
    s.voter = voter;
    s.score += s.heaviest = weight;
  }

  /// visit(shift, score) of every block with votes; then there are none.
  template <class Visit>
  void count(const Visit& visit) {
    for (const std::size_t k : used_) {
      visit(blocks_[k].at, blocks_[k].score);
      blocks_[k] = Block{};
    }
    used_.clear();
  }

 private:
  static constexpr int nobody = -1;
  struct Block {
    Step at;
    int voter = nobody;
    double heaviest = 0.0, score = 0.0;
  };

  std::size_t find(const Step& at) const {
    const auto mixed = [](std::uint64_t h, int v) { return (h ^ static_cast<std::uint32_t>(v)) * 0x9e3779b97f4a7c15U; };
    std::size_t k = static_cast<std::size_t>(mixed(mixed(mixed(0, at.x), at.y), at.z) >> 32U) & (blocks_.size() - 1);
    while (blocks_[k].voter != nobody && blocks_[k].at != at) k = (k + 1) & (blocks_.size() - 1);
    return k;
  }

  void grow() {
    std::vector<Block> before(2 * blocks_.size());
    before.swap(blocks_);
    std::vector<std::size_t> used;
    used.swap(used_);
    for (const std::size_t k : used) {
      used_.push_back(find(before[k].at));
      blocks_[used_.back()] = before[k];
    }
  }

  std::vector<Block> blocks_ = std::vector<Block>(1U << 12U);
  std::vector<std::size_t> used_;
};

template <class G>
class AlignmentSearch {
 public:
  using Point = typename G::Point;
  using Tangent = typename G::Tangent;
  using Covariance = typename G::Covariance;
  using PointCovariance = typename G::PointCovariance;

  AlignmentSearch(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior, double confidence,
                  const AlignmentSearchParams& params, const LooksAlike<G>& looks_alike)
      : a_(a.landmarks),
        b_(b),
        params_(params),
        looks_alike_(looks_alike),
        index_(params.density_radius_m),
        density_(a.landmarks.size(), -1.0),
        votes_(a.landmarks.size(), -1.0),
        fits_chi2_(chi2_quantile(params.gate, G::Dim)),
        used_a_(a.landmarks.size(), false),
        used_b_(b.landmarks.size(), false) {
    measure();
    if (prior) {
      known_ = true;
      prior_ = *prior;
      prior_chi2_ = chi2_quantile(confidence, G::Dim);
      information_ = Eigen::LDLT<Covariance>(prior->covariance).solve(Covariance::Identity());
    } else {
      anywhere();
    }
    find_resolution(confidence);
    index_vicinity();
  }

  AlignmentSearchResult<G> run() {
    if (!propose()) return result_;
    refine();
    return result_;
  }

 private:
  static constexpr int Yaw = G::Dof - 1;

  // A place to begin with.
  struct Proposal {
    double score;
    int heading;
    Step shift;
    G T_a_b;
    bool operator<(const Proposal& other) const {  // better ones first
      return std::tie(other.score, heading, shift) < std::tie(score, other.heading, other.shift);
    }
  };

  const LandmarkFact<G>& in_a(int i) const { return a_[static_cast<std::size_t>(i)]; }
  const LandmarkFact<G>& in_b(int j) const { return b_.landmarks[static_cast<std::size_t>(j)]; }
  int size_b() const { return static_cast<int>(b_.landmarks.size()); }
  double abscissa(int j) const { return b_.abscissa_m.empty() ? 0.0 : b_.abscissa_m[static_cast<std::size_t>(j)]; }

  void measure() {
    for (const auto& l : b_.landmarks) centre_ += l.position / static_cast<double>(b_.landmarks.size());
    double variance_a = 0.0, variance_b = 0.0, first_m = abscissa(0), last_m = first_m;
    for (const auto& l : a_) {
      variance_a += l.covariance.trace() / static_cast<double>(G::Dim * a_.size());
      largest_variance_ = std::max(largest_variance_, l.covariance.trace());
    }
    for (int j = 0; j < size_b(); ++j) {
      variance_b += in_b(j).covariance.trace() / static_cast<double>(G::Dim * size_b());
      radius_m_ = std::max(radius_m_, (in_b(j).position - centre_).template head<2>().norm());
      first_m = std::min(first_m, abscissa(j));
      last_m = std::max(last_m, abscissa(j));
      middle_m_ += abscissa(j) / size_b();
    }
    // Squares of two standard deviations: what agrees lies in a block of two by two.
    square_m_ = 2.0 * std::sqrt(std::max(1e-8, variance_a + variance_b + b_.drift_m2_per_m * (last_m - first_m) / 4.0));
    for (int j = 0; j < size_b(); ++j) rarity_.push_back(share_alike(in_b(j)));
  }

  // Share of the landmarks of a that look like one of b.
  double share_alike(const LandmarkFact<G>& l) const {
    if (!looks_alike_) return 1.0;
    const std::size_t step = 1 + a_.size() / 1000;  // of a large map, some
    std::size_t asked = 1, alike = 1;
    for (std::size_t i = 0; i < a_.size(); i += step, ++asked) alike += looks_alike_(a_[i], l) ? 1 : 0;
    return static_cast<double>(alike) / static_cast<double>(asked);
  }

  bool alike(int i, int j) const { return !looks_alike_ || looks_alike_(in_a(i), in_b(j)); }

  // No prior: centre over centre, turned and shifted until nothing touches.
  void anywhere() {
    Point centre_a = Point::Zero();
    for (const auto& l : a_) centre_a += l.position / static_cast<double>(a_.size());
    for (const auto& l : a_) reach_m_ = std::max(reach_m_, (l.position - centre_a).template head<2>().norm());
    reach_m_ += radius_m_;
    prior_.mean = G::from_rotation(G().rotation(), centre_a - centre_);
  }

  void find_resolution(double confidence) {
    // What turns by half a step moves by a square at most.
    turn_rad_ = std::clamp(2.0 * square_m_ / std::max(radius_m_, 1e-3), 0.1 * M_PI / 180.0, 2.0 * M_PI / 180.0);
    double widest_rad = M_PI;
    if (known_) {
      const Covariance& P = prior_.covariance;
      const double variance = std::max(P(Yaw, Yaw), 1e-12);
      widest_rad = std::min(M_PI, std::sqrt(chi2_quantile(confidence, 2) * variance));
      by_yaw_ = P.col(Yaw) / variance;
      given_yaw_ = P - P.col(Yaw) * P.row(Yaw) / variance;
      const auto H = prior_.mean.act_jacobian(centre_);
      const PointCovariance C = H * given_yaw_ * H.transpose();
      if constexpr (G::Dim == 3)  // what a tilt lifts the farthest landmark by
        storey_m_ = std::max(square_m_, radius_m_ * std::sqrt(given_yaw_.diagonal().template segment<2>(3).maxCoeff()));
      reach_m_ = std::sqrt(prior_chi2_ * eigenvalues(C.template topLeftCorner<2, 2>().eval())[1]) + 2.0 * square_m_;
    }
    sides_ = static_cast<int>(std::ceil(widest_rad / turn_rad_));
    const double squares = M_PI * std::max(1.0, reach_m_ * reach_m_ / (square_m_ * square_m_));
    result_.places = static_cast<std::uint64_t>(std::min(1e18, (2 * sides_ + 1) * squares));
  }

  // Landmarks of a that b may come to lie on, and those around them: however many a has.
  void index_vicinity() {
    const Eigen::Vector2d middle = (prior_.mean * centre_).template head<2>();
    const auto swing_m = [&](int heading) { return ((turned(heading) * centre_).template head<2>() - middle).norm(); };
    const double far_m =
        std::max(swing_m(-sides_), swing_m(sides_)) + reach_m_ + 2.0 * radius_m_ + 2.0 * params_.density_radius_m;
    for (std::size_t i = 0; i < a_.size(); ++i) {
      const Eigen::Vector2d at = a_[i].position.template head<2>();
      if ((at - middle).squaredNorm() <= far_m * far_m) index_.add(at, static_cast<int>(i));
    }
    index_.sort();
  }

  // Where the prior puts b if it has turned so far from its mean.
  G turned(int heading) const {
    const double yaw = heading * turn_rad_;
    if (known_) return prior_.mean * G::Exp(Tangent(by_yaw_ * yaw));
    Tangent d = Tangent::Zero();
    d[Yaw] = yaw;
    const G turn = G::Exp(d);
    return prior_.mean * G::from_rotation(turn.rotation(), centre_ - turn * centre_);  // about the centre
  }

  // False if the budget does not suffice: by what the middle heading takes, or as it is used up.
  bool propose() {
    std::uint64_t middle = 0;
    const G T = turned(0);
    for (int j = 0; j < size_b(); ++j)
      index_.each_near((T * in_b(j).position).template head<2>(), reach_m_, [&](int) { ++middle; });
    if (middle * static_cast<std::uint64_t>(2 * sides_ + 1) > params_.max_votes) {
      result_.cut_off = true;
      return false;
    }
    for (int heading = -sides_; heading <= sides_ && !result_.cut_off; ++heading) vote(heading);
    if (result_.cut_off) return false;
    std::sort_heap(proposals_.begin(), proposals_.end());
    keep_the_highest();
    return true;
  }

  void vote(int heading) {
    const double block = std::pow(2.0 * square_m_, 2) * (G::Dim == 2 ? 1.0 : 2.0 * storey_m_);  // m^2, in space m^3
    const int storeys = G::Dim == 2 ? 1 : 2;
    const G T = turned(heading);
    for (int j = 0; j < size_b(); ++j) {
      result_.cut_off = result_.votes > params_.max_votes;
      if (result_.cut_off) return;
      const Point predicted = T * in_b(j).position;
      const PointCovariance within = room_for(T, in_b(j).position);
      index_.each_near(predicted.template head<2>(), reach_m_, [&](int i) {
        const Point shift = in_a(i).position - predicted;
        ++result_.votes;
        if (known_ && shift.dot(within * shift) > prior_chi2_) return;
        if (!alike(i, j)) return;
        const double weight = vote_of(i, j, block);
        const Step step = steps_of(shift);
        for (int dz = 0; dz < storeys; ++dz)
          for (const int dx : {0, 1})
            for (const int dy : {0, 1}) ballot_.add({step.x + dx, step.y + dy, step.z + dz}, j, weight);
      });
    }
    ballot_.count([&](const Step& shift, double score) { consider(score, heading, shift, T); });
  }

  // Where all look alike it is that of the landmark of a alone, and remembered.
  double vote_of(int i, int j, double block) {
    if (looks_alike_) return std::log1p(0.5 / (density(i) * rarity_[static_cast<std::size_t>(j)] * block));
    double& known = votes_[static_cast<std::size_t>(i)];
    if (known < 0.0) known = std::log1p(0.5 / (density(i) * block));
    return known;
  }

  Step steps_of(const Point& shift) const {
    const auto steps = [](double x_m, double step_m) {
      return static_cast<int>(std::clamp(std::floor(x_m / step_m), -1e9, 1e9));  // an int, however far
    };
    return {steps(shift.x(), square_m_), steps(shift.y(), square_m_),
            G::Dim == 2 ? 0 : steps(shift[G::Dim - 1], storey_m_)};
  }

  // Inverse covariance of where a landmark may be, for one heading.
  PointCovariance room_for(const G& T, const Point& p) const {
    const auto H = T.act_jacobian(p);
    const PointCovariance C = H * given_yaw_ * H.transpose() + square_m_ * square_m_ * PointCovariance::Identity();
    return Eigen::LLT<PointCovariance>(C).solve(PointCovariance::Identity());
  }

  // Of three times as many as are looked at closely: neighbours of a high one are high.
  void consider(double score, int heading, const Step& to, const G& T) {
    Proposal p{score, heading, to, T};
    if (proposals_.size() == 3 * params_.max_proposals && !(p < proposals_.front())) return;
    Point shift = Point::Zero();
    shift.template head<2>() << to.x * square_m_, to.y * square_m_;  // the middle of the block
    if constexpr (G::Dim == 3) shift.z() = to.z * storey_m_;
    p.T_a_b = G::from_rotation(T.rotation(), T.translation() + shift);
    proposals_.push_back(p);
    std::push_heap(proposals_.begin(), proposals_.end());
    if (proposals_.size() <= 3 * params_.max_proposals) return;
    std::pop_heap(proposals_.begin(), proposals_.end());
    proposals_.pop_back();
  }

  void keep_the_highest() {
    std::vector<Proposal> kept;
    for (const Proposal& p : proposals_) {
      const bool beside = std::any_of(kept.begin(), kept.end(), [&](const Proposal& q) {
        return std::abs(p.heading - q.heading) <= 1 && std::abs(p.shift.x - q.shift.x) <= 1 &&
               std::abs(p.shift.y - q.shift.y) <= 1 && std::abs(p.shift.z - q.shift.z) <= 1;
      });
      if (!beside) kept.push_back(p);
      if (kept.size() == params_.max_proposals) break;
    }
    proposals_ = std::move(kept);
  }

  // Others like it per m^2, in space per m^3, half of one for those that are not known.
  double density(int i) {
    double& known = density_[static_cast<std::size_t>(i)];
    if (known >= 0.0) return known;
    const double r = params_.density_radius_m;
    constexpr double half_height_m = 1.5;
    double others = 0.4;
    index_.each_near(in_a(i).position.template head<2>(), r, [&](int k) {
      const double height_m = G::Dim == 2 ? 0.0 : in_a(k).position[G::Dim - 1] - in_a(i).position[G::Dim - 1];
      if (k != i && std::abs(height_m) < half_height_m) others += 1.0;
    });
    return known = others / (M_PI * r * r * (G::Dim == 2 ? 1.0 : 2.0 * half_height_m));
  }

  struct Agreement {
    double surprise;  // -2 ln of its likelihood, but for a constant
    int i, j;
    double ratio;  // how many times likelier than one of its density by chance
    auto operator<=>(const Agreement&) const = default;
  };

  // What agrees with a place, each landmark once, best first; sorted by pairing.
  std::vector<Agreement> agreements(const G& T, const Covariance& P) {
    std::vector<Agreement> all;
    const PointCovariance R = T.rotation();
    for (int j = 0; j < size_b(); ++j) {
      const Point predicted = T * in_b(j).position;
      const auto H = T.act_jacobian(in_b(j).position);
      const PointCovariance S_b = noise_of(R, j) + H * P * H.transpose();
      const double radius_m = std::sqrt(fits_chi2_ * (S_b.trace() + largest_variance_));
      index_.each_near(predicted.template head<2>(), radius_m, [&](int i) {
        if (!alike(i, j)) return;
        const PointCovariance S = S_b + in_a(i).covariance;
        const double chi2 = squared_mahalanobis(Point(in_a(i).position - predicted), S);
        if (!(chi2 < fits_chi2_)) return;
        const double volume = S.determinant();
        const double likelihood = std::exp(-0.5 * chi2) / std::sqrt(std::pow(2.0 * M_PI, G::Dim) * volume);
        all.push_back(
            {chi2 + std::log(volume), i, j, likelihood / (density(i) * rarity_[static_cast<std::size_t>(j)])});
      });
    }
    std::sort(all.begin(), all.end());
    std::vector<Agreement> kept;
    for (const Agreement& p : all) {
      auto&& a = used_a_[static_cast<std::size_t>(p.i)];
      auto&& b = used_b_[static_cast<std::size_t>(p.j)];
      if (a || b) continue;
      a = b = true;
      kept.push_back(p);
    }
    for (const Agreement& p : kept)
      used_a_[static_cast<std::size_t>(p.i)] = used_b_[static_cast<std::size_t>(p.j)] = false;
    std::sort(kept.begin(), kept.end(),
              [](const Agreement& x, const Agreement& y) { return std::tie(x.i, x.j) < std::tie(y.i, y.j); });
    return kept;
  }

  // Of a landmark of b, in the frame of a: its own, and what drift adds as seen from the middle of what is paired.
  PointCovariance noise_of(const PointCovariance& R, int j) const {
    return R * in_b(j).covariance * R.transpose() +
           b_.drift_m2_per_m * std::abs(abscissa(j) - middle_m_) * PointCovariance::Identity();
  }

  // Maximum a posteriori place of what agrees: prior and pairs. False if they do not fix it.
  bool fit(G& T, Covariance& P, const std::vector<Agreement>& pairs) {
    middle_m_ = 0.0;
    for (const Agreement& p : pairs) middle_m_ += abscissa(p.j) / static_cast<double>(pairs.size());
    for (int iteration = 0; iteration < 6; ++iteration) {
      Covariance A = Covariance::Zero();
      Tangent gradient = Tangent::Zero();
      if (known_) {
        const Tangent r = (prior_.mean.inverse() * T).Log();
        const Covariance J = G::right_jacobian_inverse(r);
        A = J.transpose() * information_ * J;
        gradient = J.transpose() * (information_ * r);
      }
      const PointCovariance R = T.rotation();
      for (const Agreement& p : pairs) {
        const auto H = T.act_jacobian(in_b(p.j).position);
        const Eigen::LLT<PointCovariance> S(PointCovariance(noise_of(R, p.j) + in_a(p.i).covariance));
        A += H.transpose() * S.solve(H);
        gradient += H.transpose() * S.solve(Point(T * in_b(p.j).position - in_a(p.i).position));
      }
      const Eigen::LDLT<Covariance> ldlt(A);
      if (ldlt.info() != Eigen::Success || !(ldlt.rcond() > 1e-14)) return false;
      const Tangent step = -ldlt.solve(gradient);
      T = T * G::Exp(step);
      P = symmetrised(Covariance(ldlt.solve(Covariance::Identity())));
      if (step.dot(A * step) < 1e-10) return true;
    }
    return true;
  }

  // The share of b that has a counterpart is not known: the likeliest of some.
  struct Likelihood {
    double log_ratio = -std::numeric_limits<double>::infinity(), share = 0.0;
  };
  Likelihood likelihood(const std::vector<Agreement>& pairs) const {
    Likelihood best;
    for (const double share : {0.05, 0.1, 0.2, 0.4, 0.6, 0.8}) {
      double sum = (size_b() - static_cast<int>(pairs.size())) * std::log1p(-share);
      for (const Agreement& p : pairs) sum += std::log((1.0 - share) + share * p.ratio);
      if (sum > best.log_ratio) best = {sum, share};
    }
    return best;
  }

  std::optional<CandidateAlignment<G>> refined(const Proposal& proposal) {
    G T = proposal.T_a_b;
    Covariance P = known_ ? given_yaw_ : Covariance(Covariance::Zero());
    P.template topLeftCorner<G::Dof, 2>().setZero();
    P.template topLeftCorner<2, G::Dof>().setZero();
    P.diagonal().template head<2>().setConstant(square_m_ * square_m_ / 3.0);
    if constexpr (G::Dim == 3) {
      P.template middleRows<1>(2).setZero();
      P.template middleCols<1>(2).setZero();
      P(2, 2) = storey_m_ * storey_m_ / 3.0;
    }
    P(Yaw, Yaw) += turn_rad_ * turn_rad_ / 3.0;
    std::vector<Agreement> pairs;
    for (int round = 0; round < 8; ++round) {
      std::vector<Agreement> next = agreements(T, P);
      if (next.size() < 3) return std::nullopt;
      const bool same = std::ranges::equal(
          next, pairs, [](const Agreement& x, const Agreement& y) { return x.i == y.i && x.j == y.j; });
      pairs = std::move(next);
      if (same) break;
      if (!fit(T, P, pairs)) return std::nullopt;
    }
    const Likelihood found = likelihood(pairs);
    CandidateAlignment<G> candidate{T, P, {}, found.log_ratio};
    for (const Agreement& p : pairs)
      if (is_likely(p, found.share)) candidate.pairings.emplace_back(p.i, p.j);
    return candidate;
  }

  void refine() {
    std::vector<CandidateAlignment<G>> all;
    for (const Proposal& p : proposals_)
      if (auto candidate = refined(p)) all.push_back(std::move(*candidate));
    std::sort(all.begin(), all.end(), [](const auto& x, const auto& y) {
      return x.log_likelihood_ratio != y.log_likelihood_ratio ? x.log_likelihood_ratio > y.log_likelihood_ratio
                                                              : x.pairings < y.pairings;
    });
    constexpr std::size_t most = 5;
    for (CandidateAlignment<G>& candidate : all) {
      const bool known = std::any_of(result_.candidates.begin(), result_.candidates.end(),
                                     [&](const auto& better) { return agree(candidate, better); });
      if (!known) result_.candidates.push_back(std::move(candidate));
      if (result_.candidates.size() == most) break;
    }
    if (!result_.candidates.empty()) result_.chance_pairings = chance_pairings(result_.candidates.front());
  }

  // How many pairings come about at places beside this one, on average.
  double chance_pairings(const CandidateAlignment<G>& here) {
    middle_m_ = 0.0;
    for (const auto& [i, j] : here.pairings) middle_m_ += abscissa(j) / static_cast<double>(here.pairings.size());
    const double share = likelihood(agreements(here.T_a_b, here.covariance)).share;
    const auto found_beside = [&](const Eigen::Vector2d& by) {
      Point shift = Point::Zero();
      shift.template head<2>() = by;
      const G beside = G::from_rotation(here.T_a_b.rotation(), here.T_a_b.translation() + shift);
      const auto pairs = agreements(beside, here.covariance);
      return std::count_if(pairs.begin(), pairs.end(), [&](const Agreement& p) { return is_likely(p, share); });
    };
    constexpr int places = 24;
    constexpr double farthest_m = 2.5, golden_angle_rad = 2.39996322972865332;
    const Eigen::Vector2d along = here.T_a_b.rotation().template topLeftCorner<2, 2>() * long_axis(here);
    std::int64_t around = 0, on_line = 0;
    for (int k = 0; k < places; ++k) {
      const double radius_m = 2.0 * square_m_ + farthest_m * k / places, angle_rad = k * golden_angle_rad;
      around += found_beside(radius_m * Eigen::Vector2d(std::cos(angle_rad), std::sin(angle_rad)));
      on_line += found_beside((k % 2 == 0 ? radius_m : -radius_m) * along);
    }
    return static_cast<double>(std::max(around, on_line)) / places;
  }

  // Of what is paired, in the frame of b.
  Eigen::Vector2d long_axis(const CandidateAlignment<G>& here) const {
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
    for (const auto& [i, j] : here.pairings) mean += in_b(j).position.template head<2>() / double(here.pairings.size());
    for (const auto& [i, j] : here.pairings) {
      const Eigen::Vector2d d = in_b(j).position.template head<2>() - mean;
      scatter += d * d.transpose();
    }
    return Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(scatter).eigenvectors().col(1);
  }

  bool is_likely(const Agreement& p, double share) const { return share * p.ratio > params_.min_odds * (1.0 - share); }

  // At least half of the pairings of one are those of the other.
  static bool agree(const CandidateAlignment<G>& x, const CandidateAlignment<G>& y) {
    std::vector<IndexPairing> common;
    std::set_intersection(x.pairings.begin(), x.pairings.end(), y.pairings.begin(), y.pairings.end(),
                          std::back_inserter(common));
    return 2 * common.size() >= std::min(x.pairings.size(), y.pairings.size());
  }

  const std::vector<LandmarkFact<G>>& a_;
  const Batch<G>& b_;
  const AlignmentSearchParams& params_;
  const LooksAlike<G>& looks_alike_;
  StripIndex index_;             // of a
  std::vector<double> density_;  // at each of a; below zero: not asked for yet
  std::vector<double> votes_;    // what each of a counts for; the same
  std::vector<double> rarity_;   // of each of b: share of a that looks like it
  double fits_chi2_;

  bool known_ = false;  // whether there is a prior
  RelativePrior<G> prior_;
  double prior_chi2_ = std::numeric_limits<double>::infinity();
  Covariance information_ = Covariance::Zero();  // of the prior
  Tangent by_yaw_ = Tangent::Zero();             // where the prior goes per radian of its yaw ...
  Covariance given_yaw_ = Covariance::Zero();    // ... and how uncertain it is then

  Point centre_ = Point::Zero();  // of b
  double radius_m_ = 0.0;         // of b about its centre
  double largest_variance_ = 0.0, middle_m_ = 0.0;
  double square_m_ = 0.0, storey_m_ = 0.0, turn_rad_ = 0.0, reach_m_ = 0.0;
  int sides_ = 0;  // headings to each side of the mean

  Ballot ballot_;
  std::vector<Proposal> proposals_;
  std::vector<bool> used_a_, used_b_;
  AlignmentSearchResult<G> result_;
};

}  // namespace

void validate(const AlignmentSearchParams& p) {
  if (!(p.gate > 0.0 && p.gate < 1.0)) throw ConfigError("association: gate must lie in (0, 1)");
  if (!(p.min_odds > 0.0 && p.density_radius_m > 0.0))
    throw ConfigError("association: min_odds and density_radius_m must be > 0");
  if (p.max_proposals < 2) throw ConfigError("association: max_proposals must be >= 2; there is no runner-up in one");
  if (p.max_votes == 0) throw ConfigError("association: max_votes must be > 0");
}

template <class G>
bool has_level(const std::optional<RelativePrior<G>>& prior) {
  if constexpr (G::Dim == 2) {
    return true;
  } else {
    return prior && prior->covariance.diagonal().template segment<2>(3).maxCoeff() < max_tilt_rad * max_tilt_rad;
  }
}

template <class G>
AlignmentSearchResult<G> find_alignments(const Batch<G>& a, const Batch<G>& b,
                                         const std::optional<RelativePrior<G>>& prior, double prior_confidence,
                                         const AlignmentSearchParams& params, const LooksAlike<G>& looks_alike) {
  if (a.landmarks.empty() || b.landmarks.empty()) return {};
  return AlignmentSearch<G>(a, b, prior, prior_confidence, params, looks_alike).run();
}

#define CONVOY_INSTANTIATE(G)                                                                       \
  template bool has_level(const std::optional<RelativePrior<G>>&);                                  \
  template AlignmentSearchResult<G> find_alignments(const Batch<G>&, const Batch<G>&,               \
                                                    const std::optional<RelativePrior<G>>&, double, \
                                                    const AlignmentSearchParams&, const LooksAlike<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
