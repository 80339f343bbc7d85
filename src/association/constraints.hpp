// Constraints of the association (paper, Section IV), apart from the search that uses them.
//
// Two batches are compared: landmarks i of batch a, landmarks j of batch b, each in the frame of its own anchor. What
// is known beforehand of the relative pose of the anchors comes from the static biases and the drift alone, never from
// the fused map, so that anyone who holds the facts finds the same associations.
#pragma once

#include <convoy/submap/fact_store.hpp>

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

namespace convoy {

struct ConstraintParams {
  double compatibility = 0.9999;  ///< chi-square confidence of eq. 5 between vehicles (the paper: 0.95). A start beyond
                                  ///< it is never found, and what looks the same within it would be taken instead
  double loop = 0.99;             ///< the same within a chain, where drift leaves little room for that
  // Of largest sets (gcbb, fig5) alone:
  double heading = 0.9999;      ///< confidence within which a pair of pairings is turned as the prior says
  double distance = 0.99;       ///< confidence that two distances are the same, 1 dof, from both covariances
  double min_distance_m = 0.3;  ///< pairs closer than this say nothing about geometry and are not compared
};

/// Landmarks in the frame of one anchor: its own, in index order, or those of several anchors in a row.
template <class G>
struct Batch {
  Key anchor;
  std::vector<LandmarkFact<G>> landmarks;
  /// Of several anchors: the abscissa at which each was seen [m], and the variance that drift adds to the difference of
  /// two per metre between them [m^2/m]. Empty and zero: what they share is in their loadings.
  std::vector<double> abscissa_m = {};
  double drift_m2_per_m = 0.0;
};

/// A constraint on single pairings that has nothing to do with where they are; empty: anything goes.
template <class G>
using LooksAlike = std::function<bool(const LandmarkFact<G>& i, const LandmarkFact<G>& j)>;

/// T_a_b with the covariance of a right perturbation.
template <class G>
struct RelativePrior {
  G mean;
  typename G::Covariance covariance = G::Covariance::Zero();
};

/// Standard deviations of persistent errors that the drift of an anchor does not state (DESIGN B1.3), for tests that
/// must not take them for a false association.
struct DriftSlack {
  double scale = 0.0;              ///< of the odometer
  double heading_rad_per_m = 0.0;  ///< of the gyro, per metre driven; in space about every axis
};

/// What the facts of the two chains say about T_a_b before any association: the drift chain within one chain, both
/// static biases and both drift chains between two; nothing if a start is unknown. All needed facts must be held.
template <class G>
std::optional<RelativePrior<G>> relative_prior(const FactStore<G>& store, const Key& anchor_a, const Key& anchor_b,
                                               const DriftSlack& slack = {});

/// True if all facts that an association of this batch depends on are held: its anchor, every landmark of it, and the
/// static bias of its chain. Before that, nobody may associate it: the result would depend on what came first.
template <class G>
bool complete(const FactStore<G>& store, const Key& anchor);

/// Batch `anchor` from the store, landmarks held so far, in metres.
template <class G>
Batch<G> batch_of(const FactStore<G>& store, const Key& anchor);

/// Adds to landmarks what a scale of this standard deviation, which they have in common, adds to their covariances: to
/// their loadings, as far as it is among the G::Shared strongest components of what they share then.
template <class G>
void add_scale_error(std::vector<LandmarkFact<G>>& landmarks, double sigma);

/// The standard deviation of the scale of a chain's landmarks; 0: they are in metres, or its start is not known yet.
template <class G>
double landmark_scale_sigma(const FactStore<G>& store, const ChainId& chain);

/// Unary constraint: eq. 5, nu^T C^-1 nu < chi2(d, alpha), with nu = l_i - T_a_b l_j and the covariances of both
/// landmarks and of T_a_b in C. No prior: everything is compatible.
template <class G>
class IndividualCompatibility {
 public:
  IndividualCompatibility(const std::optional<RelativePrior<G>>& prior, double confidence);
  bool operator()(const LandmarkFact<G>& i, const LandmarkFact<G>& j) const;

 private:
  std::optional<RelativePrior<G>> prior_;
  double threshold_;
};

/// Distances between the landmarks of one batch and their variances, computed once; of those in `used` alone, if it is
/// given: asking for another is out of bounds.
class DistanceTable {
 public:
  template <class G>
  explicit DistanceTable(const Batch<G>& batch, const std::vector<bool>& used = {});
  double distance(int i, int j) const { return distance_[at(i, j)]; }
  double variance(int i, int j) const { return variance_[at(i, j)]; }
  /// Of the direction from one to the other [rad^2].
  double turn_variance(int i, int j) const { return turn_variance_[at(i, j)]; }

 private:
  std::size_t at(int i, int j) const {
    return row_[static_cast<std::size_t>(i)] * n_ + row_[static_cast<std::size_t>(j)];
  }
  std::vector<std::size_t> row_;  // of each landmark
  std::size_t n_ = 0;
  std::vector<double> distance_, variance_, turn_variance_;
};

/// Binary constraint: the distance of i1, i2 in batch a equals that of j1, j2 in batch b.
class DistanceCompatibility {
 public:
  DistanceCompatibility(const DistanceTable& a, const DistanceTable& b, const ConstraintParams& params);
  bool operator()(int i1, int j1, int i2, int j2) const;

 private:
  const DistanceTable& a_;
  const DistanceTable& b_;
  double threshold_;
  double min_distance_m_;
};

/// Binary constraint: from i1 to i2 in batch a it is the same way as from j1 to j2 in batch b, turned by the prior.
/// Distances alone fit a mirror image. No prior: everything is compatible.
template <class G>
class HeadingCompatibility {
 public:
  HeadingCompatibility(const Batch<G>& a, const Batch<G>& b, const DistanceTable& table_a, const DistanceTable& table_b,
                       const std::optional<RelativePrior<G>>& prior, double confidence);
  bool operator()(int i1, int j1, int i2, int j2) const;

 private:
  const Batch<G>& a_;
  const DistanceTable& table_a_;
  const DistanceTable& table_b_;
  std::vector<typename G::Point> b_;  // turned
  double turn_variance_ = 0.0;        // of the prior, about the axis that is known worst
  double threshold_ = 0.0;
};

}  // namespace convoy
