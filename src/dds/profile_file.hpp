// A Fast DDS XML profile file, read strictly. Fast DDS keeps all profiles of a process in one table in which the first
// of a name wins without a word, and it takes a missing profile for the default. Here every file has names of its own,
// and what is missing, doubled or not well-formed is an error with file and line.
#pragma once

#include <convoy/config_error.hpp>

#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>

#include <map>
#include <string>
#include <utility>

namespace convoy::dds {

class ProfileFile {
 public:
  /// Loads the file. Throws ConfigError. Fast DDS's table is not thread-safe: load from one thread at a time.
  explicit ProfileFile(const std::string& path);

  /// The named profile. Throws ConfigError if the file has none of this name.
  eprosima::fastdds::dds::DomainParticipantQos participant(const std::string& name) const;

  /// The profile named like the topic if there is one, else that of the topic's class: convoy/facts, convoy/values
  /// (Pose, Digest) or convoy/requests. Throws ConfigError if the file has neither.
  eprosima::fastdds::dds::DataWriterQos writer(const eprosima::fastdds::dds::Publisher& publisher,
                                               const std::string& topic) const;
  eprosima::fastdds::dds::DataReaderQos reader(const eprosima::fastdds::dds::Subscriber& subscriber,
                                               const std::string& topic) const;
  const std::string& path() const { return path_; }
  /// "path:line" of the named profile; the path alone if the file has none of this name.
  std::string where(const std::string& element, const std::string& name) const;

 private:
  bool has(const std::string& element, const std::string& name) const { return line_of_.contains({element, name}); }
  std::string profile_of(const std::string& element, const std::string& topic) const;

  std::string path_;
  std::string prefix_;                                          // of this file's names in the table of Fast DDS
  std::map<std::pair<std::string, std::string>, int> line_of_;  // element, name
};

}  // namespace convoy::dds
