#include "libcalib/photon_transfer.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libcalib/frame_list.h"
#include "libcalib/transfer_figures.h"

namespace lacquer::calib {

namespace {

void fill_model(const TransferMeasurement& m, PhotonTransfer& t) {
  NoiseModel& model = t.model;
  const NoiseFigures& f = t.all;
  t.gain_measured = f.gain_e_per_dn.has_value();
  // Without a gain everything stays in DN.
  const std::optional<Measured>& read = t.gain_measured ? f.read_noise_e : f.read_noise_dn;
  const std::optional<Measured>& dark = t.gain_measured ? f.dark_current_e_per_s : f.dark_current_dn_per_s;
  if (t.gain_measured) model.gain_e_per_dn = f.gain_e_per_dn->value;
  model.read_noise_e = read ? read->value : 0;
  if (dark) model.dark_current_e_per_s = std::max(dark->value, 0.0);
  if (f.relative_noise) model.relative_noise = std::min(f.relative_noise->value, 1.0);
  // A curve contains its black level: the model must say the same, what differs is in the offset map.
  if (const std::vector<double>* curve = curve_of(m, 0))
    model.black_level_dn = raw_value(*curve, 0);
  else if (f.black_level_dn)
    model.black_level_dn = std::max(f.black_level_dn->value, 0.0);
  else
    model.black_level_dn = m.options().black_level_dn.value_or(0);
}

double chi_square_of_one_gain(const TransferMeasurement& m) {
  double sum = 0;
  const TransferLine& all = m.lines().back();
  for (std::size_t c = 0; c + 1 < m.lines().size(); ++c) {
    const TransferLine& line = m.lines()[c];
    if (line.slope_variance > 0) sum += std::pow(line.slope - all.slope, 2) / line.slope_variance;
  }
  return sum;
}

std::vector<float> to_float(const std::vector<double>& values, double subtract = 0) {
  std::vector<float> result(values.size());
  std::transform(values.begin(), values.end(), result.begin(), [&](double v) { return static_cast<float>(v - subtract); });
  return result;
}

/// Of a mean over channels of equal weight.
double rms_sigma(const std::vector<double>& variances) {
  double sum = 0;
  for (const double v : variances) sum += v;
  return std::sqrt(sum / static_cast<double>(variances.size()));
}

void fill_offset(const TransferMeasurement& m, PhotonTransfer& t) {
  const double black = curve_of(m, 0) ? 0 : t.model.black_level_dn;
  if (m.dark_signal().base_map) {
    t.maps.offset = to_float(m.dark_sums()->base(), black);
    t.maps.offset_sigma = rms_sigma(m.noise_of_base());
    return;
  }
  // Values without a pattern of their own: the black levels of the channels may still differ, or that of the curve be wrong.
  bool differ = false;
  for (std::size_t c = 0; c < t.channels.size(); ++c) {
    const Measured& base = m.dark_lines()[c].base;
    differ = differ || std::abs(base.value - black) > std::max(4 * base.sigma, 0.02);
  }
  if (!differ) return;
  const ChannelMap channel_of(m.shape());
  t.maps.offset.resize(m.shape().n_values());
  for (std::size_t i = 0; i < t.maps.offset.size(); ++i)
    t.maps.offset[i] = static_cast<float>(m.dark_lines()[channel_of(i)].base.value - black);
}

void fill_maps(const TransferMeasurement& m, PhotonTransfer& t) {
  SensorMaps& maps = t.maps;
  maps.width = t.width;
  maps.height = t.height;
  maps.layout = t.layout;
  if (m.darks_usable()) {
    fill_offset(m, t);
    if (m.dark_signal().rate_map) {
      maps.dark_rate = to_float(m.dark_sums()->rate());
      maps.dark_rate_sigma = rms_sigma(m.noise_of_rate());
    } else if (m.dark_sums()->has_rate()) {
      t.notes.push_back("no map of the dark current: its noise would exceed what it corrects; more or longer dark frames would tell");
    }
    if (maps.offset.empty()) t.notes.push_back("no map of the black level: its noise would exceed what it corrects; more dark frames would tell");
  }
  if (m.flat()) {
    const bool kept = m.options().shading == PhotonTransferOptions::Shading::kept;
    const double sigma = rms_sigma(m.noise_of_flat());
    if (kept || t.all.prnu->value > sigma) {
      maps.flat = to_float(kept ? m.flat()->kept : m.flat()->relative);
      maps.flat_sigma = sigma;
    } else {
      t.notes.push_back("no map of the sensitivity: its noise would exceed what it corrects; more flats would tell");
    }
  }
  t.n_hot = m.n_hot();
  t.n_dead = m.n_dead();
  t.n_erratic = m.n_erratic();
  if (t.n_hot + t.n_dead + t.n_erratic > 0) maps.bad = m.bad();
  // A dead value may show no light or less than none; it is not used, and a sensitivity must be a number.
  for (std::size_t i = 0; i < maps.flat.size(); ++i)
    if (!(maps.flat[i] > 0)) maps.flat[i] = 1;
}

void add_notes_on_inputs(const TransferMeasurement& m, PhotonTransfer& t) {
  const auto note = [&](std::string text) { t.notes.push_back(std::move(text)); };
  if (m.flat_pairs().empty()) note("no flats: gain, read noise in electrons, saturation and sensitivities are not measured");
  if (!m.has_darks()) note("no dark frames: black level as given; dark current, fixed pattern and hot values are not measured");
  if (m.darks_clipped())
    note(fmt::format("dark frames are clipped at 0: black level {} is taken, dark current and fixed pattern are not measured, read noise is "
                     "from the flats; raise the camera's black level", t.model.black_level_dn));
  if (m.darks_usable() && !m.dark_sums()->has_rate()) note("dark frames of one exposure time: no dark current; it is part of the black level");
  if (!m.flat_pairs().empty() && !t.gain_measured)
    note("gain: the flats do not show a variance that grows with the signal; more levels and brighter ones would tell");
}

void add_notes_on_results(const TransferMeasurement& m, PhotonTransfer& t) {
  const auto note = [&](std::string text) { t.notes.push_back(std::move(text)); };
  const TransferLine& line = m.lines().back();
  const double dof = line.degrees_of_freedom;
  if (dof > 0 && line.chi_square > dof + 3.5 * std::sqrt(2 * dof))
    note(fmt::format("the photon-transfer points do not lie on the line (chi^2 {:.0f} for {} degrees of freedom): standard errors are widened; "
                     "is the response linear, the lamp steady?", line.chi_square, line.degrees_of_freedom));
  if (const double n = static_cast<double>(t.channels.size()) - 1; n > 0 && t.one_gain_chi_square > n + 3.5 * std::sqrt(2 * n))
    note(fmt::format("the channels' gains differ (chi^2 {:.0f} for {} degrees of freedom): the model has the mean", t.one_gain_chi_square, n));
  if (std::abs(t.all.noise_correlation) > 0.05)
    note(fmt::format("the noise of neighbouring values is correlated ({:.2f}): the frames are interpolated or filtered, not raw, and gain "
                     "and read noise are off by more than their errors", t.all.noise_correlation));
  if (t.all.read_noise_dn && line.constant < 2 * std::sqrt(line.constant_variance))
    note(fmt::format("read noise is below what rounding to whole DN lets see: less than {:.2f} DN",
                     std::sqrt(std::max(line.constant, 0.0) + 2 * std::sqrt(line.constant_variance))));
  if (m.flat()) {
    const auto unlit = std::count(m.flat()->unlit.begin(), m.flat()->unlit.end(), 1);
    if (unlit > 0) note(fmt::format("{} values got next to no light in the flats: their sensitivity is taken as 1", unlit));
  }
}

}  // namespace

FrameSeries listed_series(const std::filesystem::path& list, int bits, acquire::PixelLayout single_channel_layout) {
  FrameSeries series;
  std::vector<std::filesystem::path> files;
  for (const ListedFrame& frame : read_frame_list(list)) {
    series.items.push_back({frame.exposure_s, fmt::format("{}:{}: {}", list.string(), frame.line, frame.file.string())});
    files.push_back(frame.file);
  }
  series.read = [files = std::move(files), bits, single_channel_layout](std::size_t i) {
    return acquire::read_frame(files[i].string(), bits, single_channel_layout);
  };
  return series;
}

PhotonTransfer photon_transfer(const FrameSeries& darks, const FrameSeries& flats, const PhotonTransferOptions& options,
                               const Progress& progress) {
  TransferMeasurement m(darks, flats, options, progress);
  m.run();
  PhotonTransfer t;
  const FrameShape& shape = m.shape();
  t.width = shape.width;
  t.height = shape.height;
  t.bits = shape.bits;
  t.layout = shape.layout;
  const auto n_channels = static_cast<std::size_t>(shape.n_channels());
  for (std::size_t c = 0; c < n_channels; ++c) t.channels.push_back(noise_figures(m, c));
  t.all = noise_figures(m, n_channels);
  t.points = m.points();
  fill_model(m, t);
  if (t.gain_measured) t.one_gain_chi_square = chi_square_of_one_gain(m);
  t.lamp_flicker = lamp_flicker(m);
  add_notes_on_inputs(m, t);
  find_saturation(m, t);
  add_notes_on_results(m, t);
  fill_maps(m, t);
  return t;
}

}  // namespace lacquer::calib
