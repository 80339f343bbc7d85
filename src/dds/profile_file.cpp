#include <convoy/dds/profile_file.hpp>
#include <convoy/dds/xml_fault.hpp>
#include <convoy/submap/content_hash.hpp>

#include <tinyxml2.h>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>

#include <filesystem>
#include <fstream>
#include <sstream>

namespace convoy::dds {

namespace edds = eprosima::fastdds::dds;
using eprosima::fastrtps::types::ReturnCode_t;

namespace {

[[noreturn]] void fail(const std::string& path, int line, const std::string& what) {
  throw ConfigError(path + (line > 0 ? ":" + std::to_string(line) : "") + ": " + what);
}

std::string read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  if (file) text << file.rdbuf();
  const char* const instead = "; name a file such as qos_profiles/loopback.xml";
  if (!file || std::filesystem::is_directory(path))
    fail(path, 0, std::string("cannot read this QoS profile file") + instead);
  if (text.str().empty()) fail(path, 1, std::string("this QoS profile file is empty") + instead);
  return text.str();
}

std::string prefix_of(const std::string& text) {
  ContentHash hash;
  for (const char c : text) hash.add(static_cast<unsigned char>(c), 1);
  std::ostringstream prefix;
  prefix << std::hex << hash.value() << '/';
  return prefix.str();
}

/// Puts `prefix` before every name of a profile or a transport below `parent` and collects the profiles' lines.
void rename(tinyxml2::XMLElement& parent, const std::string& prefix, const std::string& path,
            std::map<std::pair<std::string, std::string>, int>& line_of) {
  for (auto* child = parent.FirstChildElement(); child != nullptr; child = child->NextSiblingElement()) {
    const std::string element = child->Name();
    if (element == "library_settings" || element == "log" || child->BoolAttribute("is_default_profile"))
      fail(path, child->GetLineNum(), "'" + element + "' would change the whole process; take it out");
    if (const char* name = child->Attribute("profile_name")) {
      if (!line_of.emplace(std::pair(element, name), child->GetLineNum()).second)
        fail(path, child->GetLineNum(), "a second " + element + " profile '" + name + "'; only the first would count");
      child->SetAttribute("profile_name", (prefix + name).c_str());
    }
    if (element == "transport_id" && child->GetText() != nullptr) {
      const std::string id = prefix + child->GetText();
      child->SetText(id.c_str());
    }
    rename(*child, prefix, path, line_of);
  }
}

/// Topics of one class are used alike, and a file says only once how.
std::string class_of(const std::string& topic) {
  if (topic == "convoy/v1/Pose" || topic == "convoy/v1/Digest") return "convoy/values";
  return topic == "convoy/v1/Request" || topic == "convoy/v1/Answer" ? "convoy/requests" : "convoy/facts";
}

}  // namespace

ProfileFile::ProfileFile(const std::string& path) : path_(path) {
  const std::string text = read(path);
  prefix_ = prefix_of(text);
  tinyxml2::XMLDocument document;
  if (document.Parse(text.data(), text.size()) != tinyxml2::XML_SUCCESS)
    fail(path, document.ErrorLineNum(), xml_fault(document));
  rename(*document.RootElement(), prefix_, path, line_of_);

  auto* factory = edds::DomainParticipantFactory::get_instance();
  edds::DomainParticipantQos known;
  for (const auto& [profile, line] : line_of_)
    if (profile.first == "participant" &&
        factory->get_participant_qos_from_profile(prefix_ + profile.second, known) == ReturnCode_t::RETCODE_OK)
      return;  // the same content was loaded before
  tinyxml2::XMLPrinter printed;
  document.Print(&printed);
  if (factory->load_XML_profiles_string(printed.CStr(), static_cast<std::size_t>(printed.CStrSize() - 1)) !=
      ReturnCode_t::RETCODE_OK)
    fail(path, 0, "Fast DDS refuses an entry of this file; the log of Fast DDS (category XMLPARSER) says which");
}

std::string ProfileFile::profile_of(const std::string& element, const std::string& topic) const {
  if (has(element, topic)) return topic;
  const std::string shared = class_of(topic);
  if (has(element, shared)) return shared;
  fail(path_, 0,
       "no " + element + " profile '" + topic + "' nor one of its class; add <" + element + " profile_name=\"" +
           shared + "\">");
}

std::string ProfileFile::where(const std::string& element, const std::string& name) const {
  const auto line = line_of_.find({element, name});
  return path_ + (line == line_of_.end() ? "" : ":" + std::to_string(line->second));
}

edds::DomainParticipantQos ProfileFile::participant(const std::string& name) const {
  if (!has("participant", name))
    fail(path_, 0, "no participant profile '" + name + "'; add <participant profile_name=\"" + name + "\">");
  edds::DomainParticipantQos qos;
  const auto* factory = edds::DomainParticipantFactory::get_instance();
  if (factory->get_participant_qos_from_profile(prefix_ + name, qos) != ReturnCode_t::RETCODE_OK)
    throw ConfigError(where("participant", name) + ": Fast DDS did not take the participant profile '" + name + "'");
  return qos;
}

edds::DataWriterQos ProfileFile::writer(const edds::Publisher& publisher, const std::string& topic) const {
  const std::string name = profile_of("data_writer", topic);
  edds::DataWriterQos qos;
  if (publisher.get_datawriter_qos_from_profile(prefix_ + name, qos) != ReturnCode_t::RETCODE_OK)
    throw ConfigError(where("data_writer", name) + ": Fast DDS did not take the data_writer profile '" + name + "'");
  return qos;
}

edds::DataReaderQos ProfileFile::reader(const edds::Subscriber& subscriber, const std::string& topic) const {
  const std::string name = profile_of("data_reader", topic);
  edds::DataReaderQos qos;
  if (subscriber.get_datareader_qos_from_profile(prefix_ + name, qos) != ReturnCode_t::RETCODE_OK)
    throw ConfigError(where("data_reader", name) + ": Fast DDS did not take the data_reader profile '" + name + "'");
  return qos;
}

}  // namespace convoy::dds
