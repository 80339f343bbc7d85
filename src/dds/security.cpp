#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/pkcs7.h>
#include <openssl/x509.h>
#include <openssl/x509_vfy.h>
#include <tinyxml2.h>

#include <convoy/dds/security.hpp>

#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>

#include <array>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <string_view>

namespace convoy::dds {

namespace {

template <class T, void (*release)(T*)>
struct Release {
  void operator()(T* object) const { release(object); }
};
void release_bio(BIO* bio) { BIO_free_all(bio); }
using Bio = std::unique_ptr<BIO, Release<BIO, release_bio>>;
using Certificate = std::unique_ptr<X509, Release<X509, X509_free>>;
using Key = std::unique_ptr<EVP_PKEY, Release<EVP_PKEY, EVP_PKEY_free>>;
using Store = std::unique_ptr<X509_STORE, Release<X509_STORE, X509_STORE_free>>;
using StoreContext = std::unique_ptr<X509_STORE_CTX, Release<X509_STORE_CTX, X509_STORE_CTX_free>>;
using Signed = std::unique_ptr<PKCS7, Release<PKCS7, PKCS7_free>>;

const std::string common_name_prefix = "vehicle ", partition_prefix = "vehicle/";

/// 0 if `text` is not `prefix` and a number, written in the one way to write it.
VehicleId number_behind(const std::string& prefix, const std::string_view text) {
  VehicleId vehicle = 0;
  if (text.starts_with(prefix)) std::from_chars(text.data() + prefix.size(), text.data() + text.size(), vehicle);
  return text == prefix + std::to_string(vehicle) ? vehicle : 0;
}

[[noreturn]] void fail(const std::string& file, const std::string& what) {
  ERR_clear_error();  // it is kept per thread, and others may be looking for errors of their own
  throw ConfigError(file + ": " + what);
}

std::string in(const std::string& folder, const char* name) { return (std::filesystem::path(folder) / name).string(); }

std::string read(const std::string& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  if (stream) text << stream.rdbuf();
  if (!stream || text.str().empty())
    fail(file, "cannot read this file; the folder that scripts/make-certs makes for a vehicle holds it");
  return text.str();
}

/// Reads `text`, which must stay.
Bio memory(const std::string& text) { return Bio(BIO_new_mem_buf(text.data(), static_cast<int>(text.size()))); }

Certificate certificate(const std::string& file) {
  Certificate read_one(PEM_read_bio_X509(memory(read(file)).get(), nullptr, nullptr, nullptr));
  if (!read_one) fail(file, "is no certificate in PEM form; make it anew with scripts/make-certs");
  return read_one;
}

Key private_key(const std::string& file) {
  // Without this, OpenSSL asks whoever sits at the terminal for the password of a locked key.
  const auto no_password = [](char*, int, int, void*) { return -1; };
  Key key(PEM_read_bio_PrivateKey(memory(read(file)).get(), nullptr, no_password, nullptr));
  if (!key) fail(file, "is no private key in PEM form without a password; make it anew with scripts/make-certs");
  return key;
}

Store store_of(X509& authority) {
  Store store(X509_STORE_new());
  X509_STORE_add_cert(store.get(), &authority);
  return store;
}

void check_certificate(const std::string& file, X509& own, X509& authority) {
  const Store store = store_of(authority);
  const StoreContext context(X509_STORE_CTX_new());
  X509_STORE_CTX_init(context.get(), store.get(), &own, nullptr);
  if (X509_verify_cert(context.get()) == 1) return;
  const std::string reason = X509_verify_cert_error_string(X509_STORE_CTX_get_error(context.get()));
  fail(file, "identity_ca.pem beside it does not vouch for this certificate: " + reason +
                 "; make this vehicle anew with scripts/make-certs, and mind the clock");
}

/// The text in a document, if the authority signed just that.
std::string signed_text(const std::string& file, X509& authority) {
  const std::string content = read(file);
  const Bio document = memory(content);
  BIO* text = nullptr;
  const Signed signature(SMIME_read_PKCS7(document.get(), &text));
  const Bio owned(text);
  if (!signature) fail(file, "is no signed document; make it anew with scripts/make-certs");
  const Bio out(BIO_new(BIO_s_mem()));
  if (PKCS7_verify(signature.get(), nullptr, store_of(authority).get(), text, out.get(), PKCS7_TEXT) != 1)
    fail(file,
         "was changed after it was signed, or permissions_ca.pem beside it does not vouch for its signature; "
         "make it anew with scripts/make-certs");
  char* data = nullptr;
  const long size = BIO_get_mem_data(out.get(), &data);
  return {data, static_cast<std::size_t>(size)};
}

std::string in_rfc2253(const X509_NAME& name) {
  const Bio out(BIO_new(BIO_s_mem()));
  X509_NAME_print_ex(out.get(), &name, 0, XN_FLAG_RFC2253);
  char* data = nullptr;
  const long size = BIO_get_mem_data(out.get(), &data);
  return {data, static_cast<std::size_t>(size)};
}

void check_permissions(const std::string& file, const std::string& text, const std::string& subject) {
  tinyxml2::XMLDocument document;
  if (document.Parse(text.data(), text.size()) == tinyxml2::XML_SUCCESS)
    if (const auto* permissions = document.RootElement()->FirstChildElement("permissions"))
      for (const auto* grant = permissions->FirstChildElement("grant"); grant != nullptr;
           grant = grant->NextSiblingElement("grant"))
        if (const auto* granted = grant->FirstChildElement("subject_name"))
          if (granted->GetText() != nullptr && granted->GetText() == subject) return;
  fail(file,
       "grants nothing to '" + subject + "', whose certificate lies beside it; was a file of another vehicle copied?");
}

/// 0 if this is no name that scripts/make-certs gives.
VehicleId vehicle_of(const X509_NAME& name) {
  const int at = X509_NAME_get_index_by_NID(&name, NID_commonName, -1);
  if (at < 0) return 0;
  const ASN1_STRING* data = X509_NAME_ENTRY_get_data(X509_NAME_get_entry(&name, at));
  const std::string_view text(reinterpret_cast<const char*>(ASN1_STRING_get0_data(data)),
                              static_cast<std::size_t>(ASN1_STRING_length(data)));
  return number_behind(common_name_prefix, text);
}

}  // namespace

SecurityFolder::SecurityFolder(const std::string& path, VehicleId vehicle)
    : path_(std::filesystem::absolute(path).string()) {
  const Certificate authority = certificate(in(path, "identity_ca.pem"));
  const std::string own_file = in(path, "certificate.pem");
  const Certificate own = certificate(own_file);
  check_certificate(own_file, *own, *authority);
  if (X509_check_private_key(own.get(), private_key(in(path, "key.pem")).get()) != 1)
    fail(in(path, "key.pem"), "is not the key of certificate.pem beside it");

  const X509_NAME& name = *X509_get_subject_name(own.get());
  const std::string subject = in_rfc2253(name);
  vehicle_ = vehicle_of(name);
  if (vehicle_ == 0 || (vehicle != 0 && vehicle_ != vehicle))
    fail(own_file, "is made out to '" + subject + "' and not to 'CN=vehicle " +
                       (vehicle == 0 ? "N" : std::to_string(vehicle)) + ",...'; this is the folder of somebody else");
  std::array<char, 1024> line{};
  authority_ = X509_NAME_oneline(X509_get_subject_name(authority.get()), line.data(), static_cast<int>(line.size()));

  const Certificate signer = certificate(in(path, "permissions_ca.pem"));
  signed_text(in(path, "governance.p7s"), *signer);
  const std::string permissions = in(path, "permissions.p7s");
  check_permissions(permissions, signed_text(permissions, *signer), subject);
  constexpr std::size_t rest_of_handshake = 2500;
  if (read(own_file).size() + read(permissions).size() + rest_of_handshake > largest_handshake_bytes)
    fail(permissions, "is too large: with certificate.pem it must fit one message of " +
                          std::to_string(largest_handshake_bytes) + " bytes, less " +
                          std::to_string(rest_of_handshake));
}

void SecurityFolder::apply(eprosima::fastdds::dds::DomainParticipantQos& qos) const {
  const auto file = [&](const char* name) { return "file://" + in(path_, name); };
  auto& properties = qos.properties().properties();
  const auto set = [&](const std::string& name, const std::string& value) {
    properties.emplace_back("dds.sec." + name, value);
  };
  set("auth.plugin", "builtin.PKI-DH");
  set("auth.builtin.PKI-DH.identity_ca", file("identity_ca.pem"));
  set("auth.builtin.PKI-DH.identity_certificate", file("certificate.pem"));
  set("auth.builtin.PKI-DH.private_key", file("key.pem"));
  set("access.plugin", "builtin.Access-Permissions");
  set("access.builtin.Access-Permissions.permissions_ca", file("permissions_ca.pem"));
  set("access.builtin.Access-Permissions.governance", file("governance.p7s"));
  set("access.builtin.Access-Permissions.permissions", file("permissions.p7s"));
  set("crypto.plugin", "builtin.AES-GCM-GMAC");
}

std::string partition_of(VehicleId vehicle) { return partition_prefix + std::to_string(vehicle); }

VehicleId vehicle_of_partition(const std::string& partition) { return number_behind(partition_prefix, partition); }

}  // namespace convoy::dds
