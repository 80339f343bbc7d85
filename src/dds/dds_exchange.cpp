#include <convoy/dds/convert.hpp>
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/dds/entities.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/dds/receiver.hpp>
#include <convoy/geometry/groups.hpp>

#include <fastdds/dds/core/LoanableSequence.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/topic/Topic.hpp>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <map>
#include <mutex>

namespace convoy::dds {

namespace edds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastrtps::types::ReturnCode_t;

namespace {

std::chrono::steady_clock::time_point deadline_after(double seconds) {
  return std::chrono::steady_clock::now() +
         std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(seconds));
}

/// What the receiver leaves for take().
template <class G>
class Inbox {
 public:
  explicit Inbox(std::size_t capacity) : capacity_(capacity) {}

  void push(Message<G> message) {
    {
      const std::lock_guard lock(mutex_);
      if (queue_.size() >= capacity_) {
        ++dropped;
        return;
      }
      queue_.push_back(std::move(message));
    }
    filled_.notify_all();
  }

  std::vector<Message<G>> take() {
    std::deque<Message<G>> queue;
    {
      const std::lock_guard lock(mutex_);
      queue.swap(queue_);
    }
    return {std::make_move_iterator(queue.begin()), std::make_move_iterator(queue.end())};
  }

  bool wait(double timeout_s) {
    std::unique_lock lock(mutex_);
    return filled_.wait_until(lock, deadline_after(timeout_s), [this] { return !queue_.empty(); });
  }

  std::atomic<std::uint64_t> dropped{0};
  std::atomic<std::uint64_t> undecodable{0};
  std::atomic<std::uint64_t> hostile{0};
  std::atomic<std::uint64_t> incompatible{0};
  std::atomic<std::uint64_t> lost{0};
  std::atomic<std::uint64_t> impersonations{0};

 private:
  const std::size_t capacity_;
  std::mutex mutex_;
  std::condition_variable filled_;
  std::deque<Message<G>> queue_;
};

/// Counts, per remote participant, the endpoints that are matched with ours.
class PeerTable {
 public:
  PeerTable(const rtps::GuidPrefix_t& self, int endpoints) : self_(self), endpoints_(endpoints) {}

  void change(const edds::InstanceHandle_t& remote_endpoint, int by) {
    const rtps::GuidPrefix_t peer = rtps::iHandle2GUID(remote_endpoint).guidPrefix;
    if (peer == self_) return;
    {
      const std::lock_guard lock(mutex_);
      if ((matched_[peer] += by) <= 0) matched_.erase(peer);
    }
    changed_.notify_all();
  }

  std::size_t complete() {
    const std::lock_guard lock(mutex_);
    return complete_locked();
  }

  bool wait(std::size_t count, double timeout_s) {
    std::unique_lock lock(mutex_);
    return changed_.wait_until(lock, deadline_after(timeout_s), [&] { return complete_locked() >= count; });
  }

 private:
  std::size_t complete_locked() const {
    std::size_t count = 0;
    for (const auto& [peer, matched] : matched_)
      if (matched >= endpoints_) ++count;
    return count;
  }

  const rtps::GuidPrefix_t self_;
  const int endpoints_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::map<rtps::GuidPrefix_t, int> matched_;
};

/// One topic with its writer and its reader.
template <class G, class PubSubType>
class Channel final : public edds::DataWriterListener, public edds::DataReaderListener {
 public:
  using Sample = typename PubSubType::type;

  Channel(const Domain& domain, const char* topic_name, Inbox<G>& inbox, PeerTable& peers, Receiver& receiver)
      : domain_(domain), inbox_(inbox), peers_(peers), receiver_(receiver) {
    try {
      open(topic_name);
    } catch (...) {
      close();
      throw;
    }
  }
  ~Channel() override { close(); }
  Channel(const Channel&) = delete;
  Channel& operator=(const Channel&) = delete;

  bool write(Sample& sample) { return writer_->write(&sample); }
  bool keeps_history() const { return writer_->get_qos().durability().kind != edds::VOLATILE_DURABILITY_QOS; }

  /// What has come in since the last time, into the inbox. Where that is much, the other topics have their turn before
  /// the rest. The receiver's.
  void drain() noexcept {
    if (!filled_.exchange(false)) return;
    for (int n = 0; n < takes_in_a_row; ++n) {
      taken_.length(0), infos_.length(0);
      if (reader_->take(taken_, infos_, at_once) != ReturnCode_t::RETCODE_OK) return;
      for (int i = 0; i < taken_.length(); ++i) {
        // decoding stays none if the host registered an unguarded type: then nothing is accepted
        if (infos_[i].valid_data && infos_[i].sample_identity.writer_guid() != own_writer_)
          take_in(taken_[i], infos_[i]);
        taken_[i].decoding = Decoding::none;
      }
      if (taken_.length() < at_once) return;
    }
    on_data_available(reader_);
  }

  void on_data_available(edds::DataReader*) override {
    filled_ = true;
    receiver_.wake();
  }
  void on_publication_matched(edds::DataWriter*, const edds::PublicationMatchedStatus& status) override {
    peers_.change(status.last_subscription_handle, status.current_count_change);
  }
  void on_subscription_matched(edds::DataReader*, const edds::SubscriptionMatchedStatus& status) override {
    peers_.change(status.last_publication_handle, status.current_count_change);
  }
  void on_offered_incompatible_qos(edds::DataWriter*, const edds::OfferedIncompatibleQosStatus&) override {
    ++inbox_.incompatible;
  }
  void on_requested_incompatible_qos(edds::DataReader*, const edds::RequestedIncompatibleQosStatus&) override {
    ++inbox_.incompatible;
  }
  void on_sample_lost(edds::DataReader*, const edds::SampleLostStatus& status) override {
    inbox_.lost += static_cast<std::uint64_t>(status.total_count_change);
  }

 private:
  void open(const std::string& name) {
    edds::TypeSupport type(new GuardedType<PubSubType>);
    const ReturnCode_t registered = type.register_type(domain_.participant);
    // On a shared participant another exchange may have registered the type and created the topic before.
    if (registered != ReturnCode_t::RETCODE_OK && registered != ReturnCode_t::RETCODE_PRECONDITION_NOT_MET)
      throw ConfigError("the participant does not take the type " + type.get_type_name());
    edds::TopicDescription* topic = domain_.participant->lookup_topicdescription(name);
    if (topic == nullptr) {
      topic_ = need(domain_.participant->create_topic(name, type.get_type_name(), edds::TOPIC_QOS_DEFAULT), domain_,
                    "topic " + name);
      topic = topic_;
    }
    auto* whole_topic = need(dynamic_cast<edds::Topic*>(topic), domain_, "topic " + name);
    // The writer comes first, so that the reader's listener knows which samples are our own.
    writer_ = need(domain_.publisher->create_datawriter(whole_topic, domain_.profiles->writer(*domain_.publisher, name),
                                                        this, writer_events()),
                   domain_, "writer of " + name);
    own_writer_ = writer_->guid();
    reader_ = need(domain_.subscriber->create_datareader(topic, domain_.profiles->reader(*domain_.subscriber, name),
                                                         this, reader_events()),
                   domain_, "reader of " + name);
  }

  void close() {
    if (reader_ != nullptr) {
      reader_->set_listener(nullptr);
      domain_.subscriber->delete_datareader(reader_);
    }
    if (writer_ != nullptr) {
      writer_->set_listener(nullptr);
      domain_.publisher->delete_datawriter(writer_);
    }
    if (topic_ != nullptr) domain_.participant->delete_topic(topic_);
  }

  static edds::StatusMask writer_events() {
    return edds::StatusMask::publication_matched() << edds::StatusMask::offered_incompatible_qos();
  }
  static edds::StatusMask reader_events() {
    return edds::StatusMask::data_available()
           << edds::StatusMask::subscription_matched() << edds::StatusMask::requested_incompatible_qos()
           << edds::StatusMask::sample_lost();
  }

  /// An exception would end the process; there is none but for want of memory.
  void take_in(const Guarded<Sample>& received, const edds::SampleInfo& info) noexcept {
    try {
      accept(received, info);
    } catch (...) {
      ++inbox_.dropped;
    }
  }

  void accept(const Guarded<Sample>& received, const edds::SampleInfo& info) {
    std::vector<Message<G>> messages;
    if (received.decoding == Decoding::hostile) ++inbox_.hostile;
    else if (received.decoding != Decoding::ok) ++inbox_.undecodable;
    else if (messages_in(received.sample, messages) != WireStatus::ok) ++inbox_.hostile;
    else if (!come_from_their_sender(messages, info)) ++inbox_.impersonations;
    else
      for (Message<G>& message : messages) inbox_.push(std::move(message));
  }

  static WireStatus messages_in(const Sample& sample, std::vector<Message<G>>& messages) {
    if constexpr (std::is_same_v<Sample, v1::Answer>) return from_wire(sample, messages);
    else return from_wire(sample, messages.emplace_back());
  }

  /// What a vehicle repeats for others it sends under its own name, so that this holds for relayed facts, too.
  bool come_from_their_sender(const std::vector<Message<G>>& messages, const edds::SampleInfo& info) const {
    return domain_.admission == nullptr || domain_.admission->speaker(info.sample_identity.writer_guid()) ==
                                               messages.front().sender.vehicle;  // one sender for all
  }

  Domain domain_;
  Inbox<G>& inbox_;
  PeerTable& peers_;
  Receiver& receiver_;
  std::atomic<bool> filled_ = false;
  static constexpr std::int32_t at_once = 16, takes_in_a_row = 16;
  edds::LoanableSequence<Guarded<Sample>> taken_{at_once};
  edds::SampleInfoSeq infos_{at_once};
  edds::Topic* topic_ = nullptr;
  edds::DataWriter* writer_ = nullptr;
  edds::DataReader* reader_ = nullptr;
  rtps::GUID_t own_writer_;
};

void check(const DdsConfig& config) {
  if (config.participant != nullptr && !config.security_folder.empty())
    throw ConfigError(config.security_folder +
                      ": the security of an injected participant is its host's affair; leave security_folder empty");
  if (config.max_queued_messages == 0) throw ConfigError("max_queued_messages is 0; give room for at least 1 message");
  if (config.domain > 232) throw ConfigError("domain " + std::to_string(config.domain) + " is not in 0..232");
}

constexpr int endpoints_per_exchange = 24;  // a writer and a reader for each of twelve topics

}  // namespace

template <class G>
struct DdsExchange<G>::Impl {
  explicit Impl(const DdsConfig& config)
      : profiles((check(config), config.profile_file)),
        entities(config, profiles, wire),
        inbox(config.max_queued_messages),
        peers(entities.domain().participant->guid().guidPrefix, endpoints_per_exchange) {
    receiver.start([this] { drain(); });
  }
  ~Impl() { receiver.stop(); }

  void drain() noexcept {
    bias.drain(), landmark.drain(), prior.drain(), association.drain(), verdict.drain(), absolute_fix.drain();
    encounter.drain(), waypoint.drain(), pose.drain(), request.drain(), answer.drain(), digest.drain();
  }

  SendStatus write(const Message<G>& of, const AnchorFact<G>& fact) { return write_fact(bias, of, fact); }
  SendStatus write(const Message<G>& of, const PriorFact<G>& fact) { return write_fact(prior, of, fact); }
  SendStatus write(const Message<G>& of, const AssociationFact& fact) { return write_fact(association, of, fact); }
  SendStatus write(const Message<G>& of, const VerdictFact& fact) { return write_fact(verdict, of, fact); }
  SendStatus write(const Message<G>& of, const AbsoluteFixFact<G>& fact) { return write_fact(absolute_fix, of, fact); }
  SendStatus write(const Message<G>& of, const EncounterFact<G>& fact) { return write_fact(encounter, of, fact); }
  SendStatus write(const Message<G>& of, const WaypointFact<G>& fact) { return write_fact(waypoint, of, fact); }
  SendStatus write(const Message<G>& of, const LivePose<G>& live) { return convert_and_write(pose, of, live); }
  SendStatus write(const Message<G>& of, const Request& asked) { return convert_and_write(request, of, asked); }
  SendStatus write(const Message<G>& of, const Digest& known) { return convert_and_write(digest, of, known); }
  SendStatus write(const Message<G>& of, const LandmarkBatch<G>& batch) {
    SendStatus status = SendStatus::sent;
    for (const auto part : split(std::span<const LandmarkFact<G>>(batch.landmarks)))
      status = of_both(status, write_fact(landmark, of, part));
    return status;
  }

  template <class PubSubType, class Part>
  SendStatus write_fact(Channel<G, PubSubType>& channel, const Message<G>& of, const Part& part) {
    if (!of.repeated) return convert_and_write(channel, of, part);
    typename PubSubType::type sample;
    v1::RepeatedFact fact;
    if (to_wire<G>(of.sender, part, sample) != WireStatus::ok || to_repeated(sample, fact) != WireStatus::ok)
      return unfit();
    const SendStatus of_those_before = has_room(said_again, of.sender, fact) ? SendStatus::sent : write_answer();
    append(said_again, of.sender, std::move(fact));
    return of_those_before;
  }

  /// What waits in `said_again`.
  SendStatus write_answer() {
    if (said_again.facts().empty()) return SendStatus::sent;
    const bool written = answer.write(said_again);
    said_again.facts().clear();
    return written ? SendStatus::sent : SendStatus::rejected;
  }

  template <class PubSubType, class Part>
  SendStatus convert_and_write(Channel<G, PubSubType>& channel, const Message<G>& of, const Part& part) {
    typename PubSubType::type sample;
    if (to_wire<G>(of.sender, part, sample) != WireStatus::ok) return unfit();
    return channel.write(sample) ? SendStatus::sent : SendStatus::rejected;
  }

  SendStatus unfit() {
    ++refused_to_wire;
    return SendStatus::unfit;
  }

  std::shared_ptr<WireCounters> wire = std::make_shared<WireCounters>();
  ProfileFile profiles;
  Entities entities;
  Inbox<G> inbox;
  PeerTable peers;
  Receiver receiver;
  std::atomic<std::uint64_t> sent{0};
  std::atomic<std::uint64_t> taken{0};
  std::atomic<std::uint64_t> rejected{0};
  std::atomic<std::uint64_t> refused_to_wire{0};
  v1::Answer said_again;  // facts that go out together, of one sender; the sending thread's

  // Last, so that they are gone before anything they use.
  Channel<G, v1::BiasPubSubType> bias{entities.domain(), "convoy/v1/Bias", inbox, peers, receiver};
  Channel<G, v1::LandmarkPubSubType> landmark{entities.domain(), "convoy/v1/Landmark", inbox, peers, receiver};
  Channel<G, v1::PriorPubSubType> prior{entities.domain(), "convoy/v1/Prior", inbox, peers, receiver};
  Channel<G, v1::AssociationPubSubType> association{entities.domain(), "convoy/v1/Association", inbox, peers, receiver};
  Channel<G, v1::VerdictPubSubType> verdict{entities.domain(), "convoy/v1/Verdict", inbox, peers, receiver};
  Channel<G, v1::AbsoluteFixPubSubType> absolute_fix{entities.domain(), "convoy/v1/AbsoluteFix", inbox, peers,
                                                     receiver};
  Channel<G, v1::EncounterPubSubType> encounter{entities.domain(), "convoy/v1/Encounter", inbox, peers, receiver};
  Channel<G, v1::WaypointPubSubType> waypoint{entities.domain(), "convoy/v1/Waypoint", inbox, peers, receiver};
  Channel<G, v1::PosePubSubType> pose{entities.domain(), "convoy/v1/Pose", inbox, peers, receiver};
  Channel<G, v1::RequestPubSubType> request{entities.domain(), "convoy/v1/Request", inbox, peers, receiver};
  Channel<G, v1::AnswerPubSubType> answer{entities.domain(), "convoy/v1/Answer", inbox, peers, receiver};
  Channel<G, v1::DigestPubSubType> digest{entities.domain(), "convoy/v1/Digest", inbox, peers, receiver};
};

namespace {

/// Fast DDS's table of profiles and its factory serve one thread at a time, and a watchdog may open an exchange while
/// another vehicle of the process does.
std::mutex& opening() {
  static std::mutex mutex;
  return mutex;
}

}  // namespace

template <class G>
DdsExchange<G>::DdsExchange(const DdsConfig& config) {
  const std::lock_guard lock(opening());
  impl_ = std::make_unique<Impl>(config);
}
template <class G>
DdsExchange<G>::~DdsExchange() {
  const std::lock_guard lock(opening());
  impl_.reset();
}

template <class G>
bool DdsExchange<G>::keeps_history() const {
  return impl_->landmark.keeps_history();
}

template <class G>
SendStatus DdsExchange<G>::send(const Message<G>& message) {
  return send_together({&message, 1});
}

template <class G>
SendStatus DdsExchange<G>::send_together(std::span<const Message<G>> messages) {
  SendStatus status = SendStatus::sent;
  std::uint64_t sent = 0, said_again = 0;  // what is said again is sent with the answer that it is in
  impl_->said_again.facts().clear();       // of a call that was broken off
  for (const Message<G>& message : messages) {
    const SendStatus of_this =
        std::visit([&](const auto& payload) { return impl_->write(message, payload); }, message.payload);
    (message.repeated ? said_again : sent) += of_this == SendStatus::sent;
    status = of_both(status, of_this);
    if (status == SendStatus::rejected) break;
  }
  if (status != SendStatus::rejected) status = of_both(status, impl_->write_answer());
  impl_->sent += status == SendStatus::rejected ? sent : sent + said_again;
  impl_->rejected += status == SendStatus::rejected;
  return status;
}

template <class G>
std::vector<Message<G>> DdsExchange<G>::take(double) {
  auto messages = impl_->inbox.take();
  impl_->taken += messages.size();
  return messages;
}

template <class G>
ExchangeCounters DdsExchange<G>::counters() const {
  ExchangeCounters counters;
  counters.messages_sent = impl_->sent;
  counters.messages_taken = impl_->taken;
  counters.bytes_sent = impl_->wire->wire_bytes();
  counters.send_rejected = impl_->rejected;
  counters.undecodable = impl_->inbox.undecodable;
  counters.hostile = impl_->inbox.hostile;
  counters.dropped = impl_->inbox.dropped + impl_->wire->dropped;
  counters.incompatible_peers = impl_->inbox.incompatible;
  const SecurityCounters refused = dds_counters().refused;
  counters.unauthorised = refused.peers_unsecured + refused.peers_of_other_fleet + refused.peers_unproven +
                          refused.impersonations + refused.unprotected;
  if (Admission* admission = impl_->entities.domain().admission) counters.last_unauthorised = admission->last_refused();
  return counters;
}

template <class G>
DdsCounters DdsExchange<G>::dds_counters() const {
  const WireCounters& wire = *impl_->wire;
  SecurityCounters refused;
  if (Admission* admission = impl_->entities.domain().admission) refused = admission->counters();
  refused.impersonations = impl_->inbox.impersonations;
  return {wire.datagrams,    wire.rtps_bytes, wire.header_bytes, wire.failed_sends, impl_->refused_to_wire,
          impl_->inbox.lost, refused};
}

template <class G>
std::size_t DdsExchange<G>::peers() const {
  return impl_->peers.complete();
}
template <class G>
bool DdsExchange<G>::wait_for_peers(std::size_t count, double timeout_s) const {
  return impl_->peers.wait(count, timeout_s);
}
template <class G>
bool DdsExchange<G>::wait_for_messages(double timeout_s) const {
  return impl_->inbox.wait(timeout_s);
}

#define CONVOY_INSTANTIATE(G) template class DdsExchange<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::dds
