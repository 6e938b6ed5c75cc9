#pragma once

#include <cstddef>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "libcalib/shown_rgb.h"
#include "tools/report_page.h"
#include "tools/rgb_image.h"

/// Views of a session as pictures for the report.
namespace lacquer::tools {

/// At most `n` measurement views spread over those whose light lights what the camera sees (at most 110 deg from it).
std::vector<std::size_t> spread_views(const ReportSession& s, std::size_t n);

std::string light_name(const ReportSession& s, const acquire::ViewRecord& view);

/// What the channels are divided by so that a white surface is white: sensor and light.
glm::dvec3 white_balance(const calib::Calibration& calibration);

/// Everything covered, or where complete.
RgbImage to_picture(const calib::ShownRgb& shown, bool all_covered);

/// Mean over factor x factor pixels.
RgbImage reduced(const RgbImage& image, int factor);

/// Part of an image; cut at its border.
RgbImage cropped(const RgbImage& image, const acquire::PixelRectangle& box);

}  // namespace lacquer::tools
