// The types that are registered with the middleware: the generated ones, made safe against what a stranger may send.
//
// Fast DDS 2.9.1 calls deserialize() in its receiving thread and in take(). An exception from it ends the process, and
// the generated code throws on an unknown encapsulation. A `false` makes take_next_sample() report "no data" although
// later samples wait. So a guarded type never throws and never says false: it marks the sample, and the reader counts
// and skips what is marked.
#pragma once

#include <convoy/idl/convoyPubSubTypes.h>
#include <convoy/dds/wire_scan.hpp>

#include <fastdds/rtps/common/InstanceHandle.h>
#include <fastdds/rtps/common/SerializedPayload.h>
#include <fastrtps/utils/md5.h>
#include <fastdds/dds/topic/TopicDataType.hpp>

#include <algorithm>
#include <array>
#include <iterator>
#include <type_traits>

namespace convoy::dds {

/// A sample and what became of it. The sample comes first, so that a pointer to one is a pointer to the other.
template <class Sample>
struct Guarded {
  Sample sample;
  Decoding decoding = Decoding::none;
};

template <class PubSubType>
class GuardedType final : public PubSubType {
 public:
  using Sample = typename PubSubType::type;
  static_assert(std::is_standard_layout_v<Guarded<Sample>>);

  GuardedType() {
    this->auto_fill_type_object(false);
    this->auto_fill_type_information(false);
  }

  void* createData() override { return new Guarded<Sample>; }
  void deleteData(void* data) override { delete static_cast<Guarded<Sample>*>(data); }

  /// `data` points to a Guarded<Sample>. Always true.
  bool deserialize(eprosima::fastrtps::rtps::SerializedPayload_t* payload, void* data) override {
    auto* guarded = static_cast<Guarded<Sample>*>(data);
    guarded->decoding = decode(*payload, guarded->sample);
    return true;
  }

  /// The key of every type of convoy.idl is its vehicle. (The generated code writes the key to a buffer that all
  /// threads share.)
  bool getKey(void* data, eprosima::fastrtps::rtps::InstanceHandle_t* handle, bool force_md5) override {
    const std::uint32_t vehicle = static_cast<const Sample*>(data)->vehicle();
    std::array<unsigned char, 16> key{};
    for (unsigned i = 0; i < 4; ++i) key[i] = static_cast<unsigned char>(vehicle >> (24 - 8 * i));
    if (force_md5) {
      MD5 md5;
      md5.init();
      md5.update(key.data(), 4);
      md5.finalize();
      std::copy(std::begin(md5.digest), std::end(md5.digest), key.begin());
    }
    for (unsigned i = 0; i < 16; ++i) handle->value[i] = key[i];
    return true;
  }

  // Samples travel as serialised bytes, never as memory that another process may write.
  bool is_bounded() const override { return false; }
  bool is_plain() const override { return false; }
  bool construct_sample(void*) const override { return false; }

 private:
  Decoding decode(eprosima::fastrtps::rtps::SerializedPayload_t& payload, Sample& sample) noexcept {
    const Decoding scanned = scan_payload<Sample>(payload.data, payload.length);
    if (scanned != Decoding::ok) return scanned;
    try {
      return PubSubType::deserialize(&payload, &sample) ? Decoding::ok : Decoding::undecodable;
    } catch (...) {
      return Decoding::undecodable;
    }
  }
};

}  // namespace convoy::dds
