#pragma once

#include <memory>
#include <string>
#include <vector>

#include "libacquire/tic/control_transfers.h"

/// Tics on USB, through libusb-1.0. They are known by vendor, product and serial number, never by their place in a list.
namespace lacquer::acquire {

struct FoundTic {
  std::string product;  ///< "T825"
  std::string serial;   ///< empty: could not be read
  std::string problem;  ///< why it cannot be opened (permissions); empty: it can
};

/// Throws Error{device} if USB itself cannot be used.
std::vector<FoundTic> find_usb_tics();

/// Opens the Tic with this serial number; empty: the only one. Throws Error{device}: none, several, not allowed.
std::unique_ptr<ControlTransfers> open_usb_tic(const std::string& serial);

}  // namespace lacquer::acquire
