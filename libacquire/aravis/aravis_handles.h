#pragma once

#include <arv.h>
#include <fmt/format.h>

#include <memory>
#include <string>

#include "libbrdf/error.h"

/// Ownership and errors of GLib objects; private to libacquire/aravis.
namespace lacquer::acquire::detail {

struct Unref {
  void operator()(void* object) const { g_object_unref(object); }
};
template <typename T>
using GlibPtr = std::unique_ptr<T, Unref>;

struct GFree {
  void operator()(void* memory) const { g_free(memory); }
};

/// Collects the GError of one call: `call(..., failure.out()); failure.check("setting Width");`
class Failure {
 public:
  explicit Failure(std::string camera) : camera_(std::move(camera)) {}
  Failure(const Failure&) = delete;
  Failure& operator=(const Failure&) = delete;
  ~Failure() { g_clear_error(&error_); }

  GError** out() {
    g_clear_error(&error_);
    return &error_;
  }
  explicit operator bool() const { return error_ != nullptr; }
  /// Throws Error{device} if the last call failed.
  void check(const std::string& doing) const {
    if (!error_) return;
    std::string text = error_->message ? error_->message : "unknown error";
    for (char& c : text)
      if (static_cast<unsigned char>(c) < 0x20) c = ' ';
    const char* hint = "";
    if (error_->domain == ARV_DEVICE_ERROR && error_->code == ARV_DEVICE_ERROR_NOT_CONTROLLER)
      hint = "; another program has it, or one that crashed had it less than 3 s ago";
    else if (error_->domain == ARV_DEVICE_ERROR && (error_->code == ARV_DEVICE_ERROR_TIMEOUT || error_->code == ARV_DEVICE_ERROR_NOT_CONNECTED))
      hint = "; was it unplugged?";
    throw Error(ErrorCode::device, fmt::format("{}: {}: {}{}", camera_, doing, text, hint));
  }

 private:
  std::string camera_;
  GError* error_ = nullptr;
};

/// Opens by id or address; by serial number; empty: the only camera. Throws Error{device}.
GlibPtr<ArvCamera> open_device(const std::string& id);

}  // namespace lacquer::acquire::detail
