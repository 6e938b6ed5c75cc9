#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

#include "libcalib/uniformity.h"

namespace lacquer::calib {

namespace {

constexpr int max_degree = 6;
constexpr int blocks_per_side = 48;
constexpr double unlit_share = 0.02;  ///< of the channel's mean light

/// Legendre polynomials 0..degree at u in [-1, 1]: nearly orthogonal on the frame, so that the normal equations are well conditioned.
std::array<double, max_degree + 1> legendre(double u) {
  std::array<double, max_degree + 1> p{1, u};
  for (std::size_t n = 2; n <= max_degree; ++n) {
    const double k = static_cast<double>(n);
    p[n] = ((2 * k - 1) * u * p[n - 1] - (k - 1) * p[n - 2]) / k;
  }
  return p;
}

double centred(double x, int size) { return size > 1 ? 2 * x / (size - 1) - 1 : 0; }

/// Mean signal and centroid of the good values of one channel in one block.
struct Block {
  double n = 0, x = 0, y = 0, signal = 0;
};

std::vector<Block> block_means(const std::vector<double>& signal, const FrameShape& shape, const BadMask& bad, std::size_t channel) {
  const std::size_t size = static_cast<std::size_t>(std::max({4, (shape.width + blocks_per_side - 1) / blocks_per_side,
                                                              (shape.height + blocks_per_side - 1) / blocks_per_side}));
  const std::size_t per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(shape.layout));
  const std::size_t across = (static_cast<std::size_t>(shape.width) + size - 1) / size;
  const std::size_t down = (static_cast<std::size_t>(shape.height) + size - 1) / size;
  std::vector<Block> blocks(across * down);
  const ChannelMap channel_of(shape);
  for (std::size_t y = 0; y < static_cast<std::size_t>(shape.height); ++y)
    for (std::size_t k = 0; k < shape.row_size(); ++k) {
      const std::size_t i = y * shape.row_size() + k, x = k / per_pixel;
      if (channel_of(i) != channel || (!bad.empty() && bad[i])) continue;
      Block& b = blocks[y / size * across + x / size];
      b.n += 1;
      b.x += static_cast<double>(x);
      b.y += static_cast<double>(y);
      b.signal += signal[i];
    }
  std::erase_if(blocks, [](const Block& b) { return b.n == 0; });
  for (Block& b : blocks) b.x /= b.n, b.y /= b.n, b.signal /= b.n;
  return blocks;
}

/// Sum over i + k <= degree of c[i][k] P_i(x) P_k(y).
struct Polynomial {
  int degree = 0;
  std::array<std::array<double, max_degree + 1>, max_degree + 1> c{};
  int n_terms() const { return (degree + 1) * (degree + 2) / 2; }
};

Polynomial fit_polynomial(const std::vector<Block>& blocks, const FrameShape& shape) {
  Polynomial p;
  for (int d = max_degree; d > 0 && p.degree == 0; --d)  // four blocks per term at least
    if ((d + 1) * (d + 2) / 2 * 4 <= static_cast<int>(blocks.size())) p.degree = d;
  const int n = p.n_terms();
  cv::Mat normal = cv::Mat::zeros(n, n, CV_64F), right = cv::Mat::zeros(n, 1, CV_64F), solution;
  std::vector<double> row(static_cast<std::size_t>(n));
  for (const Block& b : blocks) {
    const auto px = legendre(centred(b.x, shape.width)), py = legendre(centred(b.y, shape.height));
    std::size_t term = 0;
    for (std::size_t i = 0; i <= static_cast<std::size_t>(p.degree); ++i)
      for (std::size_t k = 0; i + k <= static_cast<std::size_t>(p.degree); ++k) row[term++] = px[i] * py[k];
    for (int r = 0; r < n; ++r) {
      right.at<double>(r) += b.n * row[static_cast<std::size_t>(r)] * b.signal;
      for (int s = 0; s < n; ++s) normal.at<double>(r, s) += b.n * row[static_cast<std::size_t>(r)] * row[static_cast<std::size_t>(s)];
    }
  }
  cv::solve(normal, right, solution, cv::DECOMP_SVD);  // a single row or column of pixels leaves terms undetermined
  int term = 0;
  for (std::size_t i = 0; i <= static_cast<std::size_t>(p.degree); ++i)
    for (std::size_t k = 0; i + k <= static_cast<std::size_t>(p.degree); ++k) p.c[i][k] = solution.at<double>(term++);
  return p;
}

/// The polynomial at each pixel, row by row.
std::vector<float> evaluate(const Polynomial& p, const FrameShape& shape) {
  std::vector<std::array<double, max_degree + 1>> columns;
  for (int x = 0; x < shape.width; ++x) columns.push_back(legendre(centred(x, shape.width)));
  std::vector<float> smooth;
  smooth.reserve(columns.size() * static_cast<std::size_t>(shape.height));
  for (int y = 0; y < shape.height; ++y) {
    const auto py = legendre(centred(y, shape.height));
    std::array<double, max_degree + 1> along{};  // coefficients in x of this row
    for (std::size_t i = 0; i <= max_degree; ++i)
      for (std::size_t k = 0; k <= max_degree; ++k) along[i] += p.c[i][k] * py[k];
    for (const auto& px : columns) {
      double value = 0;
      for (std::size_t i = 0; i <= max_degree; ++i) value += along[i] * px[i];
      smooth.push_back(static_cast<float>(value));
    }
  }
  return smooth;
}

void divide_channel(const std::vector<double>& signal, const FrameShape& shape, const BadMask& bad, std::size_t channel, FlatField& flat) {
  const std::vector<Block> blocks = block_means(signal, shape, bad, channel);
  double n = 0, mean = 0;
  for (const Block& b : blocks) n += b.n, mean += b.n * b.signal;
  mean = n > 0 ? mean / n : 0;
  flat.channel_mean.push_back(mean);
  flat.shading_range.push_back(0);
  if (!(mean > 0)) return;
  const Polynomial polynomial = fit_polynomial(blocks, shape);
  flat.n_terms = polynomial.n_terms();
  const std::vector<float> smooth = evaluate(polynomial, shape);
  const auto [low, high] = std::minmax_element(smooth.begin(), smooth.end());
  flat.shading_range.back() = static_cast<double>(*high - *low) / mean;

  const std::size_t per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(shape.layout));
  const ChannelMap channel_of(shape);
  double sum = 0, count = 0;
  std::vector<std::size_t> members;
  for (std::size_t i = 0; i < signal.size(); ++i) {
    if (channel_of(i) != channel) continue;
    const auto level = static_cast<double>(smooth[i / per_pixel]);
    flat.kept[i] = signal[i] / mean;
    if (level < unlit_share * mean) {
      flat.unlit[i] = 1;
      continue;
    }
    flat.relative[i] = signal[i] / level;
    members.push_back(i);
    if (!bad.empty() && bad[i]) continue;
    sum += flat.relative[i];
    count += 1;
  }
  if (!(sum > 0)) return;
  for (const std::size_t i : members) flat.relative[i] *= count / sum;
}

}  // namespace

FlatField flat_field(const std::vector<double>& signal, const FrameShape& shape, const BadMask& bad) {
  FlatField flat;
  flat.relative.assign(signal.size(), 1);
  flat.kept.assign(signal.size(), 1);
  flat.unlit.assign(signal.size(), 0);
  for (std::size_t c = 0; c < static_cast<std::size_t>(shape.n_channels()); ++c) divide_channel(signal, shape, bad, c, flat);
  return flat;
}

}  // namespace lacquer::calib
