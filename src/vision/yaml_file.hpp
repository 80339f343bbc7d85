// YAML read strictly: every refusal says file:line, what is wrong, and how to mend it.
#pragma once

#include <yaml-cpp/yaml.h>

#include <filesystem>
#include <string>
#include <vector>

namespace convoy {

class YamlFile {
 public:
  /// Throws ConfigError if it cannot be read, is too long for what it should be (`kind`), or is no map of keys.
  YamlFile(const std::filesystem::path& path, const std::string& kind);

  const YAML::Node& root() const { return root_; }

  /// An entry of a map, or a refusal that says what it should be.
  YAML::Node required(const YAML::Node& map, const std::string& key, const std::string& what) const;
  std::string text(const YAML::Node& node, const std::string& what) const;
  double number(const YAML::Node& node, const std::string& what) const;
  int whole_number(const YAML::Node& node, const std::string& what) const;
  /// A list of numbers, or a list of such lists (rows), or a matrix as OpenCV and ROS write it (rows, cols, data). By
  /// rows.
  std::vector<double> numbers(const YAML::Node& node, const std::string& what) const;
  /// As above, of one size.
  std::vector<double> numbers(const YAML::Node& node, const std::string& what, std::size_t count) const;

  [[noreturn]] void refuse(const YAML::Node& node, const std::string& what) const;
  const std::string& name() const { return name_; }

 private:
  void refuse_repeated_keys(const YAML::Node& map, int depth) const;
  void append(const YAML::Node& list, const std::string& what, std::vector<double>& values) const;

  std::string name_;
  YAML::Node root_;
};

}  // namespace convoy
