#pragma once

#include <functional>
#include <optional>
#include <string>

#include "libbrdf/brdf.h"
#include "libbrdf/table.h"

/// PNG pictures (as bytes) for the report.
namespace lacquer::tools {

/// Value of the table's cell (theta_h, theta_d) at one phi_d, or nullopt to leave it grey.
using SliceValue = std::function<std::optional<double>(const brdf::TableGrid::Cell&)>;

/// theta_h (down, nonlinear cells) x theta_d (right) slice at phi_d = 90 deg with ticks and a colour bar; values between `low` and
/// `high` from dark to bright, the ends standing for everything beyond.
std::string slice_png(const SliceValue& value, double low, double high, const std::string& unit);

/// Sphere lit from 30 deg right and above, sRGB-coded; 1 = white Lambertian.
std::string sphere_png(const brdf::Brdf& paint, int size);

std::string base64(const std::string& bytes);

}  // namespace lacquer::tools
