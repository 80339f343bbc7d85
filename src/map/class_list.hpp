// ClassList: classes of landmarks, one after the other in one piece of memory.
#pragma once

#include <convoy/submap/facts.hpp>

#include <cstddef>
#include <iterator>
#include <span>
#include <utility>
#include <vector>

namespace convoy {

/// Landmarks that are the same, class by class; the members of each are sorted, and the classes by their first one.
class ClassList {
 public:
  ClassList() = default;
  /// Class c has the members [c == 0 ? 0 : end[c - 1], end[c]).
  ClassList(std::vector<Key> members, std::vector<std::size_t> end)
      : members_(std::move(members)), end_(std::move(end)) {}

  std::size_t size() const { return end_.size(); }
  bool empty() const { return end_.empty(); }
  std::span<const Key> operator[](std::size_t c) const {
    return std::span(members_).subspan(begin_of(c), end_[c] - begin_of(c));
  }
  /// Of class c, in members().
  std::size_t begin_of(std::size_t c) const { return c == 0 ? 0 : end_[c - 1]; }
  std::size_t end_of(std::size_t c) const { return end_[c]; }
  /// Of all classes.
  const std::vector<Key>& members() const { return members_; }

  class Iterator {
   public:
    using iterator_category = std::input_iterator_tag;
    using value_type = std::span<const Key>;
    using difference_type = std::ptrdiff_t;
    using reference = value_type;
    using pointer = void;
    Iterator() = default;
    Iterator(const ClassList* list, std::size_t c) : list_(list), c_(c) {}
    value_type operator*() const { return (*list_)[c_]; }
    Iterator& operator++() {
      ++c_;
      return *this;
    }
    Iterator operator++(int) { return {list_, c_++}; }
    bool operator==(const Iterator&) const = default;

   private:
    const ClassList* list_ = nullptr;
    std::size_t c_ = 0;
  };
  Iterator begin() const { return {this, 0}; }
  Iterator end() const { return {this, size()}; }
  bool operator==(const ClassList&) const = default;

 private:
  std::vector<Key> members_;
  std::vector<std::size_t> end_;
};

}  // namespace convoy
