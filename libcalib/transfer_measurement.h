#pragma once

#include <memory>
#include <vector>

#include "libcalib/dark_line.h"
#include "libcalib/frame_statistics.h"
#include "libcalib/transfer_fit.h"
#include "libcalib/uniformity.h"

/// The passes over the frames behind photon_transfer(). Internal to libcalib.
namespace lacquer::calib {

/// Two frames of one exposure time and what they say, per channel.
struct PairRecord {
  double exposure_s = 0;
  std::string name;  ///< of the first frame
  std::vector<PairStatistics> statistics;
  std::vector<TransferPoint::Use> use;  ///< per channel, flats only
  /// The frames follow the light: not clipped, no full well.
  bool good(std::size_t channel) const {
    return use[channel] == TransferPoint::Use::fitted || use[channel] == TransferPoint::Use::quantised;
  }
};

/// State that grows pass by pass; every vector per channel has one entry per channel.
class TransferMeasurement {
 public:
  TransferMeasurement(const FrameSeries& darks, const FrameSeries& flats, const PhotonTransferOptions& options, const Progress& progress);

  /// All passes. Values found bad in one pass are left out of the next.
  void run();

  const PhotonTransferOptions& options() const { return options_; }
  const FrameShape& shape() const { return reader_.shape(); }
  int saturation() const;  ///< raw value from which a flat counts as clipped
  bool has_darks() const { return dark_sums_ != nullptr; }
  bool darks_usable() const { return has_darks() && !darks_clipped_; }
  bool darks_clipped() const { return darks_clipped_; }
  const DarkSums* dark_sums() const { return dark_sums_.get(); }
  /// Relative sensitivities, shading removed; nullptr without usable flats.
  const FlatField* flat() const { return flat_ ? &*flat_ : nullptr; }
  const std::vector<DarkLine>& dark_lines() const { return dark_lines_; }  ///< per channel, then all together
  const std::vector<PairRecord>& flat_pairs() const { return flat_pairs_; }
  const std::vector<TransferPoint>& points() const { return points_; }
  const std::vector<TransferLine>& lines() const { return lines_; }  ///< per channel, then all together
  const BadMask& bad() const { return bad_; }
  std::size_t n_hot() const { return n_hot_; }
  std::size_t n_dead() const { return n_dead_; }
  std::size_t n_erratic() const { return n_erratic_; }
  const DarkSignal& dark_signal() const { return dark_; }
  /// Noise variance of one entry of dark_sums()->base(), of rate(), of flat()->relative, per channel.
  std::vector<double> noise_of_base() const;
  std::vector<double> noise_of_rate() const;
  std::vector<double> noise_of_flat() const;
  const std::vector<Measured>& base_spread() const { return base_spread_; }  ///< per channel, then all
  const std::vector<Measured>& rate_spread() const { return rate_spread_; }
  const std::vector<Measured>& flat_spread() const { return flat_spread_; }

 private:
  using Groups = std::vector<std::vector<std::size_t>>;
  template <typename OnFrame, typename OnPair>
  void for_each_frame(const FrameSeries& series, const Groups& groups, const char* stage, const OnFrame& on_frame, const OnPair& on_pair);

  void sum_darks();
  void find_hot();
  void measure_darks();
  void set_dark_lines(const std::vector<std::pair<double, std::vector<ChannelMean>>>& frames);
  void set_dark_signal();
  void measure_flats();
  void fit();
  std::vector<bool> good_flats() const;
  void sum_flats();
  void set_flat();
  void find_dead();
  void find_erratic();
  DarkSums::Errors dark_errors(std::size_t channel) const;
  std::size_t n_channels() const { return static_cast<std::size_t>(shape().n_channels()); }

  const FrameSeries& darks_;
  const FrameSeries& flats_;
  const PhotonTransferOptions& options_;
  const Progress& progress_;
  CheckedReader reader_;
  Groups dark_groups_, flat_groups_;
  Linearisation linear_;
  std::unique_ptr<DarkSums> dark_sums_;
  std::unique_ptr<FlatSums> flat_sums_;
  std::vector<bool> in_sums_;  ///< which pairs and channels, one after the other
  std::optional<FlatField> flat_;
  bool darks_clipped_ = false;
  std::vector<PairRecord> dark_pairs_, flat_pairs_;
  std::vector<DarkLine> dark_lines_;
  std::vector<Measured> base_spread_, rate_spread_, flat_spread_;
  DarkSignal dark_;
  std::vector<TransferPoint> dark_points_, points_;
  std::vector<TransferLine> lines_;
  BadMask bad_;
  std::size_t n_hot_ = 0, n_dead_ = 0, n_erratic_ = 0;
};

}  // namespace lacquer::calib
