#include <convoy/dds/admission.hpp>
#include <convoy/dds/security.hpp>

#include <fastdds/rtps/builtin/data/ParticipantProxyData.h>
#include <fastdds/rtps/builtin/data/WriterProxyData.h>
#include <fastdds/rtps/participant/ParticipantDiscoveryInfo.h>
#include <fastdds/rtps/writer/WriterDiscoveryInfo.h>
#include <fastrtps/utils/IPLocator.h>

#include <algorithm>
#include <sstream>

namespace convoy::dds {

namespace rtps = eprosima::fastrtps::rtps;

namespace {

/// A handshake takes a fraction of a second, or, where messages are lost, some of its repeats at 0.5, 1, 2, 4 s.
constexpr std::chrono::seconds patience{10};

/// Writers that are gone and known still. A vehicle has twelve.
constexpr std::size_t gone_writers = 1200;

/// What an announcement says of itself, which proves nothing; empty if it does not.
std::string claimed_authority(const rtps::ParticipantProxyData& peer) {
  for (const auto& property : peer.identity_token_.properties())
    if (property.name() == "dds.ca.sn") return property.value();
  return {};
}

/// What a stranger wrote, fit for a log.
std::string readable(std::string text) {
  constexpr std::size_t enough = 100;
  if (text.size() > enough) text.resize(enough);
  for (char& c : text)
    if (c < ' ' || c > '~') c = '?';
  return text;
}

std::string who(const rtps::ParticipantProxyData& peer) {
  std::ostringstream text;
  text << "participant " << peer.m_guid.guidPrefix;
  for (const auto& locator : peer.default_locators.unicast) {
    text << " at " << rtps::IPLocator::ip_to_string(locator);
    break;
  }
  return text.str();
}

}  // namespace

void Admission::on_participant_discovery(eprosima::fastdds::dds::DomainParticipant*,
                                         rtps::ParticipantDiscoveryInfo&& info) {
  using Info = rtps::ParticipantDiscoveryInfo;
  const std::lock_guard lock(mutex_);
  const rtps::GuidPrefix_t& prefix = info.info.m_guid.guidPrefix;
  if (info.status == Info::REMOVED_PARTICIPANT || info.status == Info::DROPPED_PARTICIPANT) {
    newcomers_.erase(prefix);
    return;
  }
  const auto [at, fresh] = newcomers_.try_emplace(prefix);
  if (!fresh) return;
  Newcomer& newcomer = at->second;
  newcomer.since = std::chrono::steady_clock::now();
  const std::string authority = claimed_authority(info.info);
  if (info.info.identity_token_.class_id().empty()) {
    newcomer.counter = &SecurityCounters::peers_unsecured;
    newcomer.text = who(info.info) + " speaks without DDS Security";
  } else if (authority != authority_) {
    newcomer.counter = &SecurityCounters::peers_of_other_fleet;
    newcomer.text = who(info.info) + " is of another fleet: its authority is '" + readable(authority) + "'";
  } else {
    newcomer.counter = &SecurityCounters::peers_unproven;
    newcomer.text = who(info.info) + " did not prove that it is a vehicle of this fleet: certificate or permissions " +
                    "expired or altered, another governance, or the handshake was lost";
  }
}

void Admission::on_publisher_discovery(eprosima::fastdds::dds::DomainParticipant*, rtps::WriterDiscoveryInfo&& info) {
  const std::lock_guard lock(mutex_);
  const rtps::GUID_t writer = info.info.guid();
  if (info.status == rtps::WriterDiscoveryInfo::REMOVED_WRITER) {
    leave(writer);
    return;
  }
  const std::vector<std::string> partitions = info.info.m_qos.m_partition.names();
  const VehicleId vehicle = partitions.size() == 1 ? vehicle_of_partition(partitions[0]) : 0;
  const auto [at, fresh] = speakers_.try_emplace(writer, vehicle);
  if (fresh) return;
  std::erase(gone_, writer);
  if (at->second != vehicle) at->second = 0;  // a writer of ours never moves, and a match may outlast the move
}

// Its last samples may still lie in a reader.
void Admission::leave(const rtps::GUID_t& writer) {
  if (!speakers_.contains(writer) || std::find(gone_.begin(), gone_.end(), writer) != gone_.end()) return;
  gone_.push_back(writer);
  if (gone_.size() <= gone_writers) return;
  speakers_.erase(gone_.front());
  gone_.pop_front();
}

VehicleId Admission::speaker(const rtps::GUID_t& writer) {
  const std::lock_guard lock(mutex_);
  const auto at = speakers_.find(writer);
  return at == speakers_.end() ? 0 : at->second;
}

void Admission::onParticipantAuthentication(eprosima::fastdds::dds::DomainParticipant*,
                                            rtps::ParticipantAuthenticationInfo&& info) {
  const std::lock_guard lock(mutex_);
  const auto at = newcomers_.find(info.guid.guidPrefix);
  if (at == newcomers_.end()) return;
  if (info.status == rtps::ParticipantAuthenticationInfo::AUTHORIZED_PARTICIPANT)
    at->second.standing = Standing::admitted;
  else refuse(at->second);
}

void Admission::refuse(Newcomer& newcomer) {
  if (newcomer.standing != Standing::unknown) return;
  newcomer.standing = Standing::refused;
  ++(counters_.*newcomer.counter);
  last_refused_ = newcomer.text;
}

void Admission::refuse_who_prove_nothing() {
  const auto now = std::chrono::steady_clock::now();
  for (auto& [prefix, newcomer] : newcomers_)
    if (now - newcomer.since > patience) refuse(newcomer);
}

SecurityCounters Admission::counters() {
  const std::lock_guard lock(mutex_);
  refuse_who_prove_nothing();
  SecurityCounters counters = counters_;
  counters.unprotected = *unprotected;
  return counters;
}

std::string Admission::last_refused() {
  const std::lock_guard lock(mutex_);
  refuse_who_prove_nothing();
  return last_refused_;
}

}  // namespace convoy::dds
