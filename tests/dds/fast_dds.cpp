// A peer by another vendor: Fast DDS, as rmw_fastrtps uses it, with bytes instead of types.
//
// fast_dds DOMAIN listen FOLDER TOPIC TYPE [latched] ...: until standard input ends. Each sample is a record in
//     FOLDER/samples (u64 ns of arrival since 1970, u32 topic, u32 length, bytes), each participant and writer
//     that is found a line on standard output.
//
// UDP on 127.0.0.1 alone, no multicast, no shared memory.
#include <chrono>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <mutex>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

using namespace eprosima::fastdds::dds;
using namespace eprosima::fastrtps::rtps;
using Bytes = std::vector<unsigned char>;

static std::mutex printing;

static std::string hex(const unsigned char* data, size_t size) {
  std::string text;
  char pair[3];
  for (size_t i = 0; i < size; i++) {
    std::snprintf(pair, sizeof pair, "%02x", data[i]);
    text += pair;
  }
  return text.empty() ? "-" : text;
}

static std::string hex(const GUID_t& guid) {
  return hex(guid.guidPrefix.value, 12) + hex(guid.entityId.value, 4);
}

template <class Data>
static std::string hex_of(const Data& data) {
  return hex(data.data(), data.size());
}

class Raw : public TopicDataType {
 public:
  explicit Raw(const std::string& name) {
    setName(name.c_str());
    m_typeSize = 4096;
    m_isGetKeyDefined = false;
    auto_fill_type_object(false);
    auto_fill_type_information(false);
  }
  bool serialize(void* data, SerializedPayload_t* payload) override {
    auto& bytes = *static_cast<Bytes*>(data);
    payload->encapsulation = CDR_LE;
    payload->length = bytes.size();
    std::memcpy(payload->data, bytes.data(), bytes.size());
    return true;
  }
  bool deserialize(SerializedPayload_t* payload, void* data) override {
    static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
    auto size = static_cast<Bytes*>(data)->size();
    return [size] { return static_cast<uint32_t>(size); };
  }
  void* createData() override { return new Bytes; }
  void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
  bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

class Found : public DomainParticipantListener {
  void on_participant_discovery(DomainParticipant*, ParticipantDiscoveryInfo&& found) override {
    std::lock_guard<std::mutex> lock(printing);
    std::cout << "participant " << found.status << " " << hex(found.info.m_guid) << " "
              << hex_of(found.info.m_userData) << std::endl;
  }
  void on_publisher_discovery(DomainParticipant*, WriterDiscoveryInfo&& found) override {
    tell("writer", found.status, found.info);
  }
  void on_subscriber_discovery(DomainParticipant*, ReaderDiscoveryInfo&& found) override {
    tell("reader", found.status, found.info);
  }
  template <class Info>
  void tell(const char* kind, int status, const Info& info) {
    std::lock_guard<std::mutex> lock(printing);
    std::cout << kind << " " << status << " " << hex(info.guid()) << " " << info.topicName() << " "
              << info.typeName() << " " << int(info.m_qos.m_reliability.kind) << " "
              << int(info.m_qos.m_durability.kind) << " " << hex_of(info.m_qos.m_userData) << " " << info.has_type_information() << std::endl;
  }
};

class Taking : public DataReaderListener {
 public:
  Taking(FILE* file, uint32_t topic) : file_(file), topic_(topic) {}
  void on_data_available(DataReader* reader) override {
    Bytes bytes;
    SampleInfo info;
    while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      uint64_t now = std::chrono::system_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
      uint32_t head[2] = {topic_, static_cast<uint32_t>(bytes.size())};
      std::lock_guard<std::mutex> lock(printing);
      std::fwrite(&now, sizeof now, 1, file_);
      std::fwrite(head, sizeof head, 1, file_);
      std::fwrite(bytes.data(), 1, bytes.size(), file_);
      std::fflush(file_);
    }
  }

 private:
  FILE* file_;
  uint32_t topic_;
};

// No mask: a participant that listens to data would keep it from the readers.
static DomainParticipant* join(int domain, DomainParticipantListener* listener) {
  DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList.push_back("127.0.0.1");
  udp->maxInitialPeersRange = 16;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(udp);
  Locator_t here;
  here.kind = LOCATOR_KIND_UDPv4;
  IPLocator::setIPv4(here, "127.0.0.1");
  qos.wire_protocol().builtin.initialPeersList.push_back(here);
  qos.wire_protocol().builtin.metatrafficUnicastLocatorList.push_back(Locator_t());  // so: no multicast
  return DomainParticipantFactory::get_instance()->create_participant(domain, qos, listener, StatusMask::none());
}

static Topic* topic_of(DomainParticipant* participant, const char* name, const char* kind) {
  TypeSupport type(new Raw(kind));
  type.register_type(participant);
  return participant->create_topic(name, kind, TOPIC_QOS_DEFAULT);
}

static int listen(DomainParticipant* participant, char** words, int count) {
  FILE* file = std::fopen((std::string(words[0]) + "/samples").c_str(), "wb");
  auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  for (int place = 1, topic = 0; place + 1 < count; topic++) {
    auto* about = topic_of(participant, words[place], words[place + 1]);
    place += 2;
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 10;
    qos.endpoint().history_memory_policy = PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    if (place < count && !std::strcmp(words[place], "latched")) {
      qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
      place++;
    }
    subscriber->create_datareader(about, qos, new Taking(file, topic));
  }
  {
    std::lock_guard<std::mutex> lock(printing);  // else the word stands in the middle of a listener's line
    std::cout << "ready" << std::endl;
  }
  while (std::getchar() != EOF) {
  }
  std::lock_guard<std::mutex> lock(printing);
  std::fclose(file);
  std::cout.flush();
  std::_Exit(0);
}

int main(int count, char** words) {
  if (count < 4) return 2;
  auto* participant = join(std::atoi(words[1]), new Found);
  if (!participant) return 3;
  return listen(participant, words + 3, count - 3);
}
