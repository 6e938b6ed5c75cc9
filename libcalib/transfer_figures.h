#pragma once

#include "libcalib/transfer_measurement.h"

/// From the sums of a TransferMeasurement to figures with standard errors. Internal to libcalib.
namespace lacquer::calib {

/// Figures of one channel, or of all together (`index` = number of channels).
NoiseFigures noise_figures(const TransferMeasurement& m, std::size_t index);

/// RMS change of a flat's mean from frame to frame; empty where the noise of the means explains it.
std::optional<Measured> lamp_flicker(const TransferMeasurement& m);

/// Sets model.saturation_dn and full_well_e of `t`, whose bits and gain are known, from the level that the brightest flats pile up at.
void find_saturation(const TransferMeasurement& m, PhotonTransfer& t);

/// Curve of the response of a channel; nullptr for a linear sensor.
const std::vector<double>* curve_of(const TransferMeasurement& m, std::size_t channel);

/// Raw value whose exposure on `curve` is `exposure`, between whole values too.
double raw_value(const std::vector<double>& curve, double exposure);

}  // namespace lacquer::calib
