// scripts/make-certs, as somebody at a terminal meets it.
#include "certificates.hpp"

#include <gmock/gmock.h>

namespace convoy::dds::testing {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

std::string run(const std::string& arguments, int expected_status) {
  int status = -1;
  const std::string output = shell(CONVOY_MAKE_CERTS " " + arguments, &status);
  EXPECT_EQ(status, expected_status) << output;
  return output;
}

TEST(MakeCerts, KeysAreForTheirOwnerAloneAndNoKeyOfAnAuthorityIsInAVehiclesFolder) {
  const Scratch scratch;
  run(scratch.path.string() + "/fleet --vehicles 1,2", 0);
  int keys = 0;
  for (const auto& entry : fs::recursive_directory_iterator(scratch.path)) {
    if (entry.path().filename().string().find("key") == std::string::npos) continue;
    ++keys;
    EXPECT_EQ(entry.status().permissions(), fs::perms::owner_read | fs::perms::owner_write) << entry.path();
  }
  EXPECT_EQ(keys, 4);
  for (const auto& entry : fs::directory_iterator(scratch.path / "fleet" / "vehicle_1"))
    EXPECT_EQ(entry.path().filename().string().find("_key"), std::string::npos) << entry.path();
}

TEST(MakeCerts, OneMoreVehicleJoinsTheSameFleetAndWhatIsThereStays) {
  const Scratch scratch;
  const std::string fleet = (scratch.path / "fleet").string();
  run(fleet + " --vehicles 1,2", 0);
  const std::string ca = text_of(fleet + "/authority/identity_ca.pem"), own = text_of(fleet + "/vehicle_2/key.pem");
  EXPECT_THAT(run(fleet + " --vehicles 2,3", 0), HasSubstr("vehicle_2 is there, left as it is"));
  EXPECT_EQ(text_of(fleet + "/vehicle_3/identity_ca.pem"), ca);
  EXPECT_EQ(text_of(fleet + "/vehicle_2/key.pem"), own);
  int status = -1;
  shell("openssl verify -CAfile " + fleet + "/vehicle_1/identity_ca.pem " + fleet + "/vehicle_3/certificate.pem",
        &status);
  EXPECT_EQ(status, 0);
}

TEST(MakeCerts, TellsWhatToCopyWhere) {
  const Scratch scratch;
  const std::string said = run((scratch.path / "fleet").string() + " --vehicles 7 --days 30", 0);
  EXPECT_THAT(said, HasSubstr("valid for 30 days"));
  EXPECT_THAT(said, HasSubstr("copy OUT/vehicle_N to vehicle N"));
  EXPECT_THAT(said, HasSubstr("security=\"vehicle_N\""));
}

TEST(MakeCerts, HoldsForAsLongAsItWasTold) {
  const Scratch scratch;
  run((scratch.path / "fleet").string() + " --vehicles 1 --days 2", 0);
  const std::string check =
      "openssl x509 -noout -in " + (scratch.path / "fleet/vehicle_1/certificate.pem").string() + " -checkend ";
  int status = -1;
  shell(check + std::to_string(2 * 86400 - 600), &status);
  EXPECT_EQ(status, 0);
  shell(check + std::to_string(2 * 86400 + 600), &status);
  EXPECT_EQ(status, 1);
}

TEST(MakeCerts, RefusesFoldersOfOthersAndImpossibleArguments) {
  const Scratch scratch;
  const std::string folder = scratch.path.string();
  append(folder + "/letters.txt", "mine");
  EXPECT_THAT(run(folder + " --vehicles 1", 1), HasSubstr("holds no fleet"));
  EXPECT_EQ(text_of(folder + "/letters.txt"), "mine");
  for (const char* wrong : {"", "0", "1,,2", "1;2", "x", "4294967296"})
    EXPECT_THAT(run(folder + "/new --vehicles '" + wrong + "'", 1), HasSubstr("make-certs: ")) << wrong;
  EXPECT_THAT(run(folder + "/new --vehicles 1 --days 4000", 1), HasSubstr("1..3650"));
  EXPECT_THAT(run("--vehicles 1", 1), HasSubstr("no folder"));
  EXPECT_THAT(run(folder + "/new --vehicles", 1), HasSubstr("--vehicles wants a value"));
  EXPECT_FALSE(fs::exists(folder + "/new"));
  EXPECT_THAT(run("--help", 0), HasSubstr("OUT/authority"));
}

TEST(MakeCerts, ALostKeyOfTheAuthorityIsNamed) {
  const Scratch scratch;
  const std::string fleet = (scratch.path / "fleet").string();
  run(fleet + " --vehicles 1", 0);
  fs::remove(fleet + "/authority/permissions_key.pem");
  EXPECT_THAT(run(fleet + " --vehicles 2", 1), HasSubstr("permissions_key.pem is missing"));
  EXPECT_FALSE(fs::exists(fleet + "/vehicle_2"));
}

}  // namespace
}  // namespace convoy::dds::testing
