#pragma once

#include <filesystem>

namespace lacquer::bench {

/// Prints how long a lens of 24 boards takes after their corners are found, with its errors; best of `repeats`.
void lens_speed(int repeats);

/// Prints how long a geometry takes after its highlights are found. Without a session: the paper's plan (one LED, 181 views) with a camera of
/// a quarter of the pixels each way, and 181 LEDs with one highlight each. `smoke`: 7 views.
void geometry_speed(const std::filesystem::path& session, bool smoke);

}  // namespace lacquer::bench
