#include "certificates.hpp"

#include <sys/wait.h>

#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <sstream>
#include <stdexcept>

namespace convoy::dds::testing {

namespace {

std::filesystem::path new_folder() {
  std::string path = ::testing::TempDir() + "convoy_security_XXXXXX";
  if (mkdtemp(path.data()) == nullptr) throw std::runtime_error("cannot make a folder in " + ::testing::TempDir());
  return path;
}

std::string date_of(std::time_t time) {
  std::tm utc{};
  gmtime_r(&time, &utc);
  char text[32] = {};
  std::strftime(text, sizeof text, "%Y%m%d%H%M%SZ", &utc);
  return text;
}

void must(const std::string& command) {
  int status = 0;
  const std::string output = shell(command, &status);
  if (status != 0) throw std::runtime_error(command + ": " + output);
}

}  // namespace

std::string shell(const std::string& command, int* status) {
  std::string output;
  FILE* pipe = popen(("{ " + command + "\n} 2>&1").c_str(), "r");
  if (pipe == nullptr) throw std::runtime_error("cannot run " + command);
  char buffer[4096];
  for (std::size_t n = 0; (n = fread(buffer, 1, sizeof buffer, pipe)) > 0;) output.append(buffer, n);
  const int end = pclose(pipe);
  if (status != nullptr) *status = WIFEXITED(end) ? WEXITSTATUS(end) : -1;
  return output;
}

Scratch::Scratch() : path(new_folder()) {}
Scratch::~Scratch() { std::filesystem::remove_all(path); }

Certificates::Certificates(const std::string& vehicles) {
  must(CONVOY_MAKE_CERTS " " + scratch_.path.string() + " --vehicles " + vehicles);
}

void Certificates::certify(int vehicle, int from_s, int until_s) const {
  const std::string ca = (scratch_.path / "ca").string();
  std::filesystem::create_directories(ca);
  std::ofstream(ca + "/index.txt");
  std::ofstream(ca + "/conf") << "[ca]\ndefault_ca=fleet\n[fleet]\npolicy=any\ndatabase=" << ca
                              << "/index.txt\nserial=" << ca << "/serial\nnew_certs_dir=" << ca
                              << "\n[any]\nO=supplied\nCN=supplied\n";
  const std::time_t now = std::time(nullptr);
  must("openssl req -new -key " + folder(vehicle) + "/key.pem -subj '/O=convoy/CN=vehicle " + std::to_string(vehicle) +
       "' -out " + ca + "/request.pem");
  must("openssl ca -batch -notext -preserveDN -md sha256 -rand_serial -config " + ca + "/conf -in " + ca +
       "/request.pem -cert " + (authority() / "identity_ca.pem").string() + " -keyfile " +
       (authority() / "identity_key.pem").string() + " -startdate " + date_of(now + from_s) + " -enddate " +
       date_of(now + until_s) + " -out " + folder(vehicle) + "/certificate.pem");
}

void append(const std::string& file, const std::string& text) { std::ofstream(file, std::ios::app) << text; }

std::string text_of(const std::filesystem::path& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

}  // namespace convoy::dds::testing
