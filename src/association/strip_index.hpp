// StripIndex: which points lie near a place, by strips of y sorted by x. Memory linear in the points, wherever they
// are.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace convoy {

class StripIndex {
 public:
  /// `strip_m` > 0.
  explicit StripIndex(double strip_m) : strip_m_(strip_m) {}
  /// Points numbered from 0, sorted.
  StripIndex(const std::vector<Eigen::Vector2d>& points, double strip_m) : StripIndex(strip_m) {
    for (std::size_t k = 0; k < points.size(); ++k) add(points[k], static_cast<int>(k));
    sort();
  }

  /// A point [m] under a number of its own. Then sort().
  void add(const Eigen::Vector2d& point, int number) { items_.push_back({strip_of(point.y()), point, number}); }
  void sort() {
    std::sort(items_.begin(), items_.end(), [](const Item& l, const Item& r) {
      return l.strip != r.strip ? l.strip < r.strip : l.at.x() != r.at.x() ? l.at.x() < r.at.x() : l.number < r.number;
    });
    for (std::size_t k = 0; k < items_.size(); ++k)
      if (k == 0 || items_[k].strip != items_[k - 1].strip) strips_.push_back({items_[k].strip, k});
  }

  /// visit(number) of every point within `radius_m`, in an order of their places alone (equal ones by number).
  template <class Visit>
  void each_near(const Eigen::Vector2d& place, double radius_m, const Visit& visit) const {
    const double lowest = strip_of(place.y() - radius_m), highest = strip_of(place.y() + radius_m);
    auto strip = std::lower_bound(strips_.begin(), strips_.end(), lowest,
                                  [](const Strip& s, double number) { return s.number < number; });
    for (; strip != strips_.end() && strip->number <= highest; ++strip) {
      const std::size_t end = strip + 1 == strips_.end() ? items_.size() : (strip + 1)->first;
      auto item = std::lower_bound(items_.begin() + static_cast<std::ptrdiff_t>(strip->first),
                                   items_.begin() + static_cast<std::ptrdiff_t>(end), place.x() - radius_m,
                                   [](const Item& i, double x_m) { return i.at.x() < x_m; });
      for (; item != items_.begin() + static_cast<std::ptrdiff_t>(end) && item->at.x() <= place.x() + radius_m; ++item)
        if ((item->at - place).squaredNorm() <= radius_m * radius_m) visit(item->number);
    }
  }

 private:
  struct Item {
    double strip;
    Eigen::Vector2d at;
    int number;
  };
  struct Strip {
    double number;
    std::size_t first;
  };
  double strip_of(double y_m) const { return std::floor(y_m / strip_m_); }

  double strip_m_;
  std::vector<Item> items_;
  std::vector<Strip> strips_;
};

}  // namespace convoy
