#include "random_world.hpp"

#include <convoy/geometry/groups.hpp>

#include <Eigen/Cholesky>

namespace convoy::test {

template <int N>
Eigen::Matrix<double, N, 1> Random::draw(const Eigen::Matrix<double, N, N>& P) {
  return Eigen::Matrix<double, N, N>(P.llt().matrixL()) * unit_normal<N>();
}

template <class G>
G Random::pose_of(double half_size_m) {
  if constexpr (G::Dim == 2) {
    return pose(half_size_m);
  } else {
    typename G::Tangent d = G::Tangent::NullaryExpr([&] { return uniform(-1.0, 1.0); });
    d.template tail<3>() *= uniform(0.0, 3.1) / d.template tail<3>().norm();
    return G::from_rotation(G::Exp(d).rotation(), half_size_m * d.template head<3>());
  }
}

template <class G>
PointsOf<G> scattered(Random& random, std::size_t count, double half_size_m, double apart_m) {
  PointsOf<G> points;
  while (points.size() < count) {
    typename G::Point p;
    const auto metres = [&] { return random.uniform(-half_size_m, half_size_m); };
    p.template head<2>() = SE2::Point(metres(), metres());
    if constexpr (G::Dim == 3) p[2] = random.uniform(-6.0, 6.0);
    bool free = true;
    for (const auto& q : points) free = free && (p - q).norm() >= apart_m;
    if (free) points.push_back(p);
  }
  return points;
}

template <class G>
typename G::Loading shared_error(const typename G::Point& p, double shared_m) {
  typename G::Loading L = G::Loading::Zero();
  const typename G::PointJacobian motion = G().act_jacobian(p);  // [I, how p turns]
  L.template leftCols<G::Dim>() = shared_m * motion.template leftCols<G::Dim>();
  L.template middleCols<G::Dof - G::Dim>(G::Dim) = 0.05 * shared_m * motion.template rightCols<G::Dof - G::Dim>();
  L.col(G::Dof) = 0.05 * shared_m * p;
  return L;
}

template <class G>
typename G::PointCovariance own_covariance(double own_m) {
  typename G::PointCovariance own = G::PointCovariance::Identity();
  own.template topLeftCorner<2, 2>() << 1.0, 0.3, 0.3, 0.7;
  return own * (own_m * own_m);
}

template <class G>
Batch<G> frozen_batch(Random& random, const Key& anchor, const G& T_world_anchor, const PointsOf<G>& points,
                      const BatchNoise& noise, std::uint32_t first) {
  Batch<G> batch{anchor, {}};
  const typename G::SharedVector u = random.unit_normal<G::Shared>();
  for (const typename G::Point& p : points) {
    LandmarkFact<G> l;
    l.key = {anchor.chain, first++};
    l.anchor = anchor.index;
    const typename G::Point truth = T_world_anchor.inverse() * p;
    l.loading = shared_error<G>(truth, noise.shared_m);
    const typename G::PointCovariance own = own_covariance<G>(noise.own_m);
    l.covariance = own + l.loading * l.loading.transpose();
    l.position = truth + noise.scale * (l.loading * u + random.draw<G::Dim>(own));
    batch.landmarks.push_back(l);
  }
  return batch;
}

template Eigen::Vector2d Random::draw(const Eigen::Matrix2d&);
template Eigen::Vector3d Random::draw(const Eigen::Matrix3d&);
template Eigen::Matrix<double, 6, 1> Random::draw(const Eigen::Matrix<double, 6, 6>&);

#define CONVOY_INSTANTIATE(G)                                                                             \
  template G Random::pose_of<G>(double);                                                                  \
  template PointsOf<G> scattered<G>(Random&, std::size_t, double, double);                                \
  template G::Loading shared_error<G>(const G::Point&, double);                                           \
  template G::PointCovariance own_covariance<G>(double);                                                  \
  template Batch<G> frozen_batch<G>(Random&, const Key&, const G&, const PointsOf<G>&, const BatchNoise&, \
                                    std::uint32_t);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::test
