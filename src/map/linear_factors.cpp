#include <convoy/geometry/conditioning.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/linear_factors.hpp>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <numeric>

namespace convoy {
namespace {

// H and b of a residual with its Jacobians by the unknowns of a term, in their order.
template <int R, class... Jacobian>
double accumulate(const Eigen::MatrixXd& information, const Eigen::Matrix<double, R, 1>& r, LinearTerm* term,
                  const Jacobian&... jacobians) {
  const Eigen::Matrix<double, R, R> W = information;
  const Eigen::Matrix<double, R, 1> Wr = W * r;
  if (term == nullptr) return r.dot(Wr);
  Eigen::Matrix<double, R, (0 + ... + Jacobian::ColsAtCompileTime)> J;
  int column = 0;
  const auto put = [&](const auto& one) {
    J.middleCols(column, one.cols()) = one;
    column += static_cast<int>(one.cols());
  };
  (put(jacobians), ...);
  term->H.noalias() = J.transpose() * (W * J);
  term->b.noalias() = -(J.transpose() * Wr);
  return r.dot(Wr);
}

}  // namespace

template <class G>
LinearFactors<G>::LinearFactors(const Problem<G>& p) : problem_(p) {
  const auto each = [](const auto& list, const auto& visit) {
    for (std::size_t k = 0; k < list.size(); ++k) visit(k, list[k]);
  };
  each(p.priors, [&](std::size_t k, const auto& f) { add(Kind::prior, k, {f.node}); });
  each(p.constants,
       [&](std::size_t k, const auto&) { add(Kind::constants, k, {p.unknown_of_constants(static_cast<int>(k))}); });
  each(p.drifts, [&](std::size_t k, const auto& f) {
    if (f.constants < 0) add(Kind::drift, k, {f.a, f.b});
    else add(Kind::drift, k, {f.a, f.b, p.unknown_of_constants(f.constants)});
  });
  each(p.bounded, [&](std::size_t k, const auto& f) {
    if (f.a < 0) add(Kind::bounded, k, {f.b, p.unknown_of_constants(f.constants)});
    else add(Kind::bounded, k, {f.a, f.b, p.unknown_of_constants(f.constants)});
  });
  each(p.fixes, [&](std::size_t k, const auto& f) {
    if (f.datum < 0) add(Kind::fix, k, {f.node});
    else add(Kind::fix, k, {f.node, f.datum});
  });
  each(p.encounters, [&](std::size_t k, const auto& f) { add(Kind::encounter, k, {f.observer, f.other}); });
  add_landmarks();
}

template <class G>
void LinearFactors<G>::add(Kind kind, std::size_t index, std::initializer_list<int> unknowns) {
  factors_.push_back({kind, index, unknowns_.size(), unknowns.size(), 0});
  unknowns_.insert(unknowns_.end(), unknowns);
}

// By node, in their order. One whose error has nothing in common with the others' is a factor by itself.
template <class G>
void LinearFactors<G>::add_landmarks() {
  const std::vector<LandmarkFactor<G>>& all = problem_.landmarks;
  std::vector<std::size_t> end(problem_.nodes.size() + 1, 0);  // counting sort
  for (const auto& l : all) ++end[at(l.node) + 1];
  std::partial_sum(end.begin(), end.end(), end.begin());
  by_node_.resize(all.size());
  for (const auto& l : all) by_node_[end[at(l.node)]++] = &l;
  for (auto first = by_node_.begin(); first != by_node_.end();) {
    const int node = (*first)->node;
    const auto last = std::find_if(first, by_node_.end(), [&](const auto* l) { return l->node != node; });
    const auto shares = std::stable_partition(first, last, [](const auto* l) { return l->loading < 0; });
    const auto number = [&](auto l) { return static_cast<std::size_t>(l - by_node_.begin()); };
    for (auto l = first; l != shares; ++l) add_landmarks(number(l), number(l) + 1);
    if (shares != last) add_landmarks(number(shares), number(last));
    for (auto l = first; l != last; ++l) index_of_.push_back((*l)->landmark.index);
    first = last;
  }
}

// Those of by_node_, as one factor.
template <class G>
void LinearFactors<G>::add_landmarks(std::size_t first, std::size_t end) {
  const LandmarkFactor<G>& one = *by_node_[first];
  add(Kind::landmarks, first, {one.node});
  for (std::size_t l = first; l != end; ++l) unknowns_.push_back(problem_.unknown_of_point(by_node_[l]->point));
  if (one.constants >= 0) unknowns_.push_back(problem_.unknown_of_constants(one.constants));
  Factor& f = factors_.back();
  f.unknowns = unknowns_.size() - f.first_unknown;
  f.landmarks = end - first;
}

template <class G>
Eigen::MatrixXd LinearFactors<G>::information(int k) const {
  const Factor& f = factors_[at(k)];
  switch (f.kind) {
    case Kind::prior: return inverse_covariance(problem_.priors[f.index].covariance);
    case Kind::constants: return problem_.constants[f.index].sigma.cwiseAbs2().cwiseInverse().asDiagonal();
    case Kind::drift: return inverse_covariance(problem_.drifts[f.index].covariance);
    case Kind::bounded: return problem_.bounded[f.index].information.asDiagonal();
    case Kind::fix: return inverse_covariance(problem_.fixes[f.index].covariance);
    case Kind::encounter: return inverse_covariance(problem_.encounters[f.index].covariance);
    case Kind::landmarks: break;
  }
  const auto n = static_cast<Eigen::Index>(f.landmarks);
  if (n == 1) return inverse_covariance(landmark(f, 0).covariance);
  Eigen::MatrixXd loading(G::Dim * n, G::Shared);
  for (Eigen::Index i = 0; i < n; ++i)
    loading.template middleRows<G::Dim>(G::Dim * i) =
        problem_.loadings[at(landmark(f, static_cast<std::size_t>(i)).loading)];
  Eigen::MatrixXd covariance = loading * loading.transpose();
  for (Eigen::Index i = 0; i < n; ++i)
    covariance.template block<G::Dim, G::Dim>(G::Dim * i, G::Dim * i) = landmark(f, at(static_cast<int>(i))).covariance;
  return symmetrised(Eigen::MatrixXd(covariance.llt().solve(Eigen::MatrixXd::Identity(G::Dim * n, G::Dim * n))));
}

template <class G>
double LinearFactors<G>::linearise(int k, const Eigen::MatrixXd& W, const State<G>& state, LinearTerm* term) const {
  const Factor& factor = factors_[at(k)];
  switch (factor.kind) {
    case Kind::prior: {  // F0
      const PriorFactor<G>& f = problem_.priors[factor.index];
      const auto [r, J] = PriorResidual<G>(f, state.pose(f.node));
      return accumulate(W, r, term, J);
    }
    case Kind::drift: {  // F1
      const DriftFactor<G>& f = problem_.drifts[factor.index];
      const DriftResidual<G> one(f, state.pose(f.a), state.pose(f.b), state.constants_of(f.constants));
      if (f.constants < 0) return accumulate(W, one.r, term, one.J_a, one.J_b);
      return accumulate(W, one.r, term, one.J_a, one.J_b, one.J_c);
    }
    case Kind::fix: {  // F3
      const AbsoluteFixFactor<G>& f = problem_.fixes[factor.index];
      const AbsoluteFixResidual<G> one(f, state.pose(f.node), f.datum < 0 ? G() : state.pose(f.datum));
      if (f.datum < 0) return accumulate(W, one.r, term, one.J_T);
      return accumulate(W, one.r, term, one.J_T, one.J_D);
    }
    case Kind::encounter: {  // F4
      const EncounterFactor<G>& f = problem_.encounters[factor.index];
      const EncounterResidual<G> one(f, state.pose(f.observer), state.pose(f.other));
      return accumulate(W, one.r, term, one.J_o, one.J_w);
    }
    case Kind::constants: {  // F5
      const Constants<G> r = state.constants[factor.index] - problem_.constants[factor.index].mean;
      using Square = Eigen::Matrix<double, Constants<G>::RowsAtCompileTime, Constants<G>::RowsAtCompileTime>;
      return accumulate(W, r, term, Square(Square::Identity()));
    }
    case Kind::bounded: {  // F6
      if constexpr (G::Dim == 3) {
        const BoundedFactor& f = problem_.bounded[factor.index];
        const BoundedResidual one(f, f.a < 0 ? nullptr : &state.pose(f.a), state.pose(f.b),
                                  state.constants_of(f.constants)[2]);
        Eigen::Matrix3d J_c = Eigen::Matrix3d::Zero();
        J_c.col(2) = one.J_c;
        if (f.a < 0) return accumulate(W, one.r, term, one.J_b, J_c);
        return accumulate(W, one.r, term, one.J_a, one.J_b, J_c);
      }
      return 0.0;
    }
    case Kind::landmarks: break;
  }
  return landmarks(factor, W, state, term);
}

template <class G>
double LinearFactors<G>::landmarks(const Factor& f, const Eigen::MatrixXd& W, const State<G>& state,
                                   LinearTerm* term) const {
  const G& T = state.pose(landmark(f, 0).node);
  const int constants = landmark(f, 0).constants;
  const Constants<G> c = state.constants_of(constants);
  if (f.landmarks == 1) {
    const LandmarkFactor<G>& l = landmark(f, 0);
    const LandmarkResidual<G> one(l, T, state.point(l.point), c);
    if (constants < 0) return accumulate(W, one.r, term, one.J_T, one.J_m);
    return accumulate(W, one.r, term, one.J_T, one.J_m, one.J_c);
  }
  constexpr int C = Constants<G>::RowsAtCompileTime;
  const auto n = static_cast<Eigen::Index>(f.landmarks);
  const typename G::PointCovariance J_m = T.rotation().transpose() / (1.0 + c[0]);
  Eigen::VectorXd r(G::Dim * n);
  Eigen::Matrix<double, Eigen::Dynamic, G::Dof> J_T(G::Dim * n, G::Dof);
  Eigen::Matrix<double, Eigen::Dynamic, C> J_c(G::Dim * n, C);
  for (Eigen::Index i = 0; i < n; ++i) {
    const LandmarkFactor<G>& l = landmark(f, static_cast<std::size_t>(i));
    const LandmarkResidual<G> one(l, T, state.point(l.point), c);
    r.template segment<G::Dim>(G::Dim * i) = one.r;
    J_T.template middleRows<G::Dim>(G::Dim * i) = one.J_T;
    J_c.template middleRows<G::Dim>(G::Dim * i) = one.J_c;
  }
  const Eigen::VectorXd Wr = W.lazyProduct(r);  // too small for Eigen's packed kernels
  if (term == nullptr) return r.dot(Wr);
  const Eigen::Index at_c = G::Dof + G::Dim * n, size = at_c + (constants < 0 ? 0 : C);
  const Eigen::Matrix<double, Eigen::Dynamic, G::Dof> WJ = W.lazyProduct(J_T);
  term->H.resize(size, size);
  term->b.resize(size);
  term->H.template topLeftCorner<G::Dof, G::Dof>() = J_T.transpose().lazyProduct(WJ);
  term->b.template head<G::Dof>() = -(J_T.transpose() * Wr);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index row = G::Dof + G::Dim * i;
    const typename G::PointJacobian H_mT = J_m.transpose() * WJ.template middleRows<G::Dim>(G::Dim * i);
    term->H.template block<G::Dim, G::Dof>(row, 0) = H_mT;
    term->H.template block<G::Dof, G::Dim>(0, row) = H_mT.transpose();
    term->b.template segment<G::Dim>(row) = -(J_m.transpose() * Wr.template segment<G::Dim>(G::Dim * i));
    for (Eigen::Index j = 0; j < n; ++j)
      term->H.template block<G::Dim, G::Dim>(row, G::Dof + G::Dim * j) =
          J_m.transpose() * W.template block<G::Dim, G::Dim>(G::Dim * i, G::Dim * j) * J_m;
  }
  if (constants >= 0) {
    const Eigen::Matrix<double, Eigen::Dynamic, C> WJ_c = W.lazyProduct(J_c);
    term->H.template topRightCorner<G::Dof, C>() = J_T.transpose().lazyProduct(WJ_c);
    for (Eigen::Index i = 0; i < n; ++i)
      term->H.template block<G::Dim, C>(G::Dof + G::Dim * i, at_c) =
          J_m.transpose() * WJ_c.template middleRows<G::Dim>(G::Dim * i);
    term->H.template bottomRightCorner<C, C>() = J_c.transpose().lazyProduct(WJ_c);
    term->H.bottomLeftCorner(C, at_c) = term->H.topRightCorner(at_c, C).transpose();
    term->b.template tail<C>() = -(J_c.transpose() * Wr);
  }
  return r.dot(Wr);
}

// A key says what a landmark, a fix or an encounter is, and the nodes what lies between them.
template <class G>
bool LinearFactors<G>::says_the_same(int k, const LinearFactors& other, int k_other) const {
  const Factor &f = factors_[at(k)], &g = other.factors_[at(k_other)];
  if (f.kind != g.kind || f.unknowns != g.unknowns) return false;
  const Problem<G>& there = other.problem_;
  switch (f.kind) {
    case Kind::prior: {
      const PriorFactor<G>&a = problem_.priors[f.index], &b = there.priors[g.index];
      return a.mean.translation() == b.mean.translation() && a.mean.rotation() == b.mean.rotation() &&
             a.covariance == b.covariance;
    }
    case Kind::constants: {
      const ConstantsFactor<G>&a = problem_.constants[f.index], &b = there.constants[g.index];
      return a.mean == b.mean && a.sigma == b.sigma;
    }
    case Kind::drift:
    case Kind::bounded: return true;
    case Kind::fix: return problem_.fixes[f.index].fix == there.fixes[g.index].fix;
    case Kind::encounter: {  // its answer may have been replaced
      const EncounterFactor<G>&a = problem_.encounters[f.index], &b = there.encounters[g.index];
      return a.encounter == b.encounter && a.mark == b.mark;
    }
    case Kind::landmarks: break;
  }
  const auto first = [](const LinearFactors& of, const Factor& factor) {
    return of.index_of_.begin() + static_cast<std::ptrdiff_t>(factor.index);
  };
  return std::equal(first(*this, f), first(*this, f) + static_cast<std::ptrdiff_t>(f.landmarks), first(other, g));
}

template <class G>
int LinearFactors<G>::residuals() const {
  // F6 stands for what F1 no longer says.
  return G::Dof * static_cast<int>(problem_.priors.size() + problem_.drifts.size()) +
         G::Dim * static_cast<int>(problem_.landmarks.size() + problem_.fixes.size() + problem_.encounters.size()) +
         Constants<G>::RowsAtCompileTime * static_cast<int>(problem_.constants.size());
}

#define CONVOY_INSTANTIATE(G) template class LinearFactors<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
