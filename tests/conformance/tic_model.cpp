#include "conformance/tic_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libbrdf/error.h"

namespace lacquer::test {

namespace {

constexpr double command_timeout_s = 1.0;   // as delivered
constexpr double low_supply_v = 6.0;
constexpr std::uint16_t intentionally_off = 1, driver = 2, low_vin = 4, kill = 8, timeout = 64, safe_start = 128;

}  // namespace

TicModel::TicModel(acquire::Clock& clock) : clock_(clock), time_(clock.now()), settings_(0x60, 0) {
  settings_[0x31] = 0xFF;  // no other current during errors
  settings_[0x53] = 2;     // decelerate to hold
  last_command_ = energised_since_ = time_;
}

std::uint16_t TicModel::errors() const {
  unsigned bits = 0;
  if (!energise_wanted_) bits |= intentionally_off;
  if (driver_error_) bits |= driver;
  if (supply_v_ < low_supply_v) bits |= low_vin;
  if (kill_switch_) bits |= kill;
  if (timed_out_) bits |= timeout;
  if (safe_start_) bits |= safe_start;
  return static_cast<std::uint16_t>(bits);
}

std::uint8_t TicModel::state() const {
  const unsigned bits = errors();
  if (bits & (driver | low_vin)) return 0;
  if (bits & intentionally_off) return 2;
  if (bits) return 4;
  if (time_ - energised_since_ < 0.02) return 8;  // coil current stabilising
  return 10;
}

void TicModel::advance() {
  const double now = clock_.now();
  while (time_ < now) {
    const double dt = std::min(1e-3, now - time_);
    step(dt);
    time_ = dt < 1e-3 ? now : time_ + dt;
  }
}

void TicModel::step(double dt) {
  const bool was_normal = state() == 10 || state() == 8;
  if (time_ - last_command_ > command_timeout_s) timed_out_ = true;
  errors_occurred_ |= errors();
  const std::uint8_t now = state();
  if (now <= 2) {  // coils without current
    velocity_ = 0;
    uncertain_ = true;
    plan_ = Plan::off;
    return;
  }
  if (now == 4 && was_normal && plan_ != Plan::off) {  // soft error: decelerate to hold
    if (plan_ == Plan::home_towards || plan_ == Plan::home_away) uncertain_ = true;
    plan_ = Plan::velocity;
    target_velocity_ = 0;
  }
  if (now == 8) return;
  const double acceleration = max_acceleration_ / 100.0, limit = max_speed_ / 1e4;
  double wanted = 0;
  const double count = position_ - offset_;
  if (plan_ == Plan::position) {
    const double way = target_position_ - count;
    if (std::abs(way) <= 0.5 && std::abs(velocity_) <= acceleration * 2e-3 + 1) {
      position_ += way;
      velocity_ = 0;
      return;
    }
    // Fastest speed that still stops in time.
    wanted = std::copysign(std::min(limit, std::max(std::sqrt(2 * acceleration * std::abs(way) * 0.9), 1.0)), way);
  } else if (plan_ == Plan::velocity) {
    wanted = std::clamp(target_velocity_ / 1e4, -limit, limit);
  } else if (plan_ == Plan::home_towards) {
    wanted = home_forward_ ? limit : -limit;
    if (!no_switch_ && (home_forward_ ? position_ >= forward_limit_ : position_ <= reverse_limit_)) plan_ = Plan::home_away;
  } else if (plan_ == Plan::home_away) {
    wanted = (home_forward_ ? -limit : limit) / 4;
    if (home_forward_ ? position_ < forward_limit_ : position_ > reverse_limit_) {
      plan_ = Plan::off;
      velocity_ = 0;
      offset_ = position_;
      uncertain_ = false;
      return;
    }
  }
  const double change = std::clamp(wanted - velocity_, -acceleration * dt, acceleration * dt);
  velocity_ += change;
  if (plan_ != Plan::home_towards && plan_ != Plan::home_away) {
    // Reaching a limit switch stops the motor at once, so steps may be lost.
    if ((velocity_ > 0 && position_ >= forward_limit_) || (velocity_ < 0 && position_ <= reverse_limit_)) {
      velocity_ = 0;
      uncertain_ = true;
    }
  }
  if (velocity_ != 0) {
    highest_speed_ = std::max(highest_speed_, std::abs(velocity_));
    highest_acceleration_ = std::max(highest_acceleration_, std::abs(change) / dt);
    if (uncertain_ && plan_ == Plan::position) moved_while_uncertain_ = true;
  }
  if (!jammed_) position_ += velocity_ * dt;
}

bool TicModel::command(std::uint8_t request, std::uint16_t value, std::uint16_t index) {
  const auto word = static_cast<std::int32_t>(static_cast<std::uint32_t>(value) | static_cast<std::uint32_t>(index) << 16);
  const auto heard = [&] {
    last_command_ = time_;
    timed_out_ = false;
  };
  switch (request) {
    case 0xE0: heard(); plan_ = Plan::position; target_position_ = word; return true;
    case 0xE3: heard(); plan_ = Plan::velocity; target_velocity_ = word; return true;
    case 0xEC: heard(); plan_ = Plan::off; velocity_ = 0; offset_ = position_ - word; uncertain_ = state() <= 2; return true;
    case 0x89: heard(); plan_ = Plan::off; velocity_ = 0; uncertain_ = true; return true;
    case 0x97: heard(); plan_ = Plan::home_towards; home_forward_ = value == 1; uncertain_ = true; return true;
    case 0x8C: heard(); return true;
    case 0x86: energise_wanted_ = false; uncertain_ = true; velocity_ = 0; plan_ = Plan::off; return true;
    case 0x85: heard(); if (!energise_wanted_) energised_since_ = time_; energise_wanted_ = true; return true;
    case 0x83: heard(); safe_start_ = false; return true;
    case 0x8F: safe_start_ = true; return true;
    case 0x8A: driver_error_ = false; return true;
    case 0xE6: max_speed_ = static_cast<std::uint32_t>(word); return true;
    case 0xE5: starting_speed_ = static_cast<std::uint32_t>(word); return true;
    case 0xEA: max_acceleration_ = static_cast<std::uint32_t>(word); return true;
    case 0xE9: max_deceleration_ = static_cast<std::uint32_t>(word); return true;
    case 0x91: current_limit_ = static_cast<std::uint8_t>(std::min<unsigned>(value, highest_current_limit_)); return true;
    case 0x94: if (value <= highest_step_mode_) step_mode_ = static_cast<std::uint8_t>(value); return true;
    default: return false;
  }
}

std::vector<std::uint8_t> TicModel::variables() {
  std::vector<std::uint8_t> v(0x60, 0);
  const auto put = [&](std::size_t offset, std::uint32_t value, int n) {
    for (int i = 0; i < n; ++i) v[offset + static_cast<std::size_t>(i)] = static_cast<std::uint8_t>(value >> (8 * i));
  };
  const bool homing = plan_ == Plan::home_towards || plan_ == Plan::home_away;
  put(0x00, state(), 1);
  const unsigned flags = (state() > 2 ? 1u : 0u) | (uncertain_ ? 2u : 0u) | (position_ >= forward_limit_ ? 4u : 0u) |
                         (position_ <= reverse_limit_ ? 8u : 0u) | (homing ? 16u : 0u);
  put(0x01, flags, 1);
  put(0x02, errors(), 2);
  put(0x04, errors_occurred_, 4);
  put(0x09, plan_ == Plan::position ? 1 : plan_ == Plan::off ? 0 : 2, 1);
  put(0x0A, static_cast<std::uint32_t>(target_position_), 4);
  put(0x16, max_speed_, 4);
  put(0x22, static_cast<std::uint32_t>(static_cast<std::int32_t>(std::llround(position_ - offset_))), 4);
  put(0x26, static_cast<std::uint32_t>(static_cast<std::int32_t>(std::llround(velocity_ * 1e4))), 4);
  put(0x33, static_cast<std::uint32_t>(std::llround(supply_v_ * 1e3)), 2);
  put(0x49, step_mode_, 1);
  put(0x4A, current_limit_, 1);
  return v;
}

std::optional<std::vector<std::uint8_t>> TicModel::control(std::uint8_t request_type, std::uint8_t request, std::uint16_t value, std::uint16_t index,
                                                           std::uint16_t length) {
  const std::lock_guard lock(mutex_);
  advance();
  if (request_type == 0x40) {
    log_.push_back(request >= 0xE0 && request != 0xFF ? fmt::format("{:02x} v={:04x} i={:04x}", request, value, index)
                   : request == 0x97 || request == 0x94 ? fmt::format("{:02x} v={:04x}", request, value) : fmt::format("{:02x}", request));
    if (!command(request, value, index)) return std::nullopt;
    errors_occurred_ |= errors();
    return std::vector<std::uint8_t>{};
  }
  if (request_type != 0xC0) return std::nullopt;
  const auto block = [&](const std::vector<std::uint8_t>& all) -> std::optional<std::vector<std::uint8_t>> {
    if (index + length > static_cast<int>(all.size())) return std::nullopt;
    return std::vector<std::uint8_t>(all.begin() + index, all.begin() + index + length);
  };
  if (request == 0xA8) return block(settings_);
  if (request != 0xA1 && request != 0xA2) return std::nullopt;
  auto result = block(variables());
  if (request == 0xA2) errors_occurred_ = 0;
  return result;
}

double TicModel::physical_position() {
  const std::lock_guard lock(mutex_);
  advance();
  return position_;
}
bool TicModel::energised() {
  const std::lock_guard lock(mutex_);
  advance();
  return state() > 2;
}
void TicModel::set_supply(double volts) { const std::lock_guard lock(mutex_); advance(); supply_v_ = volts; }
void TicModel::set_driver_error(bool on) { const std::lock_guard lock(mutex_); advance(); driver_error_ = on; }
void TicModel::set_kill_switch(bool on) { const std::lock_guard lock(mutex_); advance(); kill_switch_ = on; }
void TicModel::set_missing_limit_switch() { const std::lock_guard lock(mutex_); no_switch_ = true; }
void TicModel::set_limit_switches(double reverse_at, double forward_at) {
  const std::lock_guard lock(mutex_);
  reverse_limit_ = reverse_at;
  forward_limit_ = forward_at;
}
void TicModel::set_jammed(bool on) { const std::lock_guard lock(mutex_); advance(); jammed_ = on; }
void TicModel::power_cycle() {
  const std::lock_guard lock(mutex_);
  advance();
  offset_ = position_;
  velocity_ = 0;
  plan_ = Plan::off;
  uncertain_ = true;
  safe_start_ = true;
  step_mode_ = 0;
}
void TicModel::set_setting(std::uint8_t offset, std::uint8_t value) { const std::lock_guard lock(mutex_); settings_.at(offset) = value; }
std::vector<std::string> TicModel::out_log() { const std::lock_guard lock(mutex_); return log_; }

void ModelTransfers::fault(std::uint8_t request) {
  const int k = faults_->n_transfers++;
  if (k == faults_->unplug_at) faults_->unplugged = true;
  if (faults_->unplugged) throw Error(ErrorCode::device, fmt::format("{}: USB request 0x{:02X}: was unplugged", name(), request));
  if (k == faults_->stall_at) throw Error(ErrorCode::device, fmt::format("{}: USB request 0x{:02X}: refused the request", name(), request));
  if (k == faults_->time_out_at) throw Error(ErrorCode::timeout, fmt::format("{}: USB request 0x{:02X}: does not answer", name(), request));
}

void ModelTransfers::control_out(std::uint8_t request, std::uint16_t value, std::uint16_t index) {
  fault(request);
  if (!model_->control(0x40, request, value, index, 0))
    throw Error(ErrorCode::device, fmt::format("{}: USB request 0x{:02X}: refused the request", name(), request));
}

std::vector<std::uint8_t> ModelTransfers::control_in(std::uint8_t request, std::uint16_t value, std::uint16_t index, std::uint16_t length) {
  fault(request);
  auto data = model_->control(0xC0, request, value, index, length);
  if (!data) throw Error(ErrorCode::device, fmt::format("{}: USB request 0x{:02X}: refused the request", name(), request));
  return std::move(*data);
}

}  // namespace lacquer::test
