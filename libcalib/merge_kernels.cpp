#include "libcalib/merge_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
#define LACQUER_AVX2 __attribute__((target("avx2")))
#endif
#define LACQUER_INLINE inline __attribute__((always_inline))

namespace lacquer::calib {

namespace {

/// One value of all exposures; what the vector loop does, in the same order of operations.
LACQUER_INLINE std::uint32_t add_one(const ExposureValues* exposures, std::size_t n_exposures, std::size_t i, const ValueMeaning& meaning,
                                     const SumsView& out) {
  float s0 = out.sums[0][i], s1 = out.sums[1][i], s2 = out.sums[2][i];
  std::uint32_t usable = out.usable[i], seen = 0;
  const std::int32_t offset = meaning.offsets[i % meaning.period];
  for (std::size_t j = 0; j < n_exposures; ++j) {
    const ExposureValues& x = exposures[j];
    const std::uint32_t v = x.values[i];
    seen |= v;
    float e;
    bool clipped;
    if (meaning.linear) {
      e = static_cast<float>(static_cast<std::int32_t>(v)) - meaning.black;
      clipped = static_cast<std::int32_t>(v) >= meaning.clipped;
    } else {
      e = x.table[static_cast<std::int32_t>(v & meaning.largest) + offset];
      clipped = e >= clipped_limit;
    }
    if (clipped) e = 0;
    s0 += e;
    s1 += x.basis1 * e;
    s2 += x.basis2 * e;
    usable |= clipped ? 0u : x.bit;
  }
  out.sums[0][i] = s0, out.sums[1][i] = s1, out.sums[2][i] = s2;
  out.usable[i] = usable;
  return seen;
}

#ifdef LACQUER_AVX2
/// 24 values at once: three vectors, so that periods of 1, 2 and 3 fit. Their sums stay in registers while the exposures pass.
constexpr std::size_t block = 24;

template <bool linear>
LACQUER_AVX2 std::uint32_t add_avx2(const ExposureValues* exposures, std::size_t n_exposures, std::size_t n, const ValueMeaning& meaning,
                                    const SumsView& out) {
  __m256i offsets[3];
  for (int k = 0; k < 3; ++k) {
    alignas(32) std::array<std::int32_t, 8> lane;
    for (std::size_t i = 0; i < 8; ++i) lane[i] = meaning.offsets[(static_cast<std::size_t>(k) * 8 + i) % meaning.period];
    offsets[k] = _mm256_load_si256(reinterpret_cast<const __m256i*>(lane.data()));
  }
  const __m256 black = _mm256_set1_ps(meaning.black);
  const __m256i clipped = _mm256_set1_epi32(linear ? meaning.clipped : std::bit_cast<std::int32_t>(clipped_limit));
  const __m256i largest = _mm256_set1_epi32(static_cast<std::int32_t>(meaning.largest));
  __m256i seen = _mm256_setzero_si256();
  for (std::size_t i = 0; i + block <= n; i += block) {
    __m256 s0[3], s1[3], s2[3];
    __m256i usable[3];
    for (std::size_t k = 0; k < 3; ++k) {
      s0[k] = _mm256_loadu_ps(out.sums[0] + i + 8 * k);
      s1[k] = _mm256_loadu_ps(out.sums[1] + i + 8 * k);
      s2[k] = _mm256_loadu_ps(out.sums[2] + i + 8 * k);
      usable[k] = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(out.usable + i + 8 * k));
    }
    for (std::size_t j = 0; j < n_exposures; ++j) {
      const ExposureValues& x = exposures[j];
      const __m256 b1 = _mm256_set1_ps(x.basis1), b2 = _mm256_set1_ps(x.basis2);
      const __m256i bit = _mm256_set1_epi32(static_cast<std::int32_t>(x.bit));
      for (std::size_t k = 0; k < 3; ++k) {
        const __m256i v = _mm256_cvtepu16_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(x.values + i + 8 * k)));
        seen = _mm256_or_si256(seen, v);
        __m256 e;
        __m256i good;
        if constexpr (linear) {
          e = _mm256_sub_ps(_mm256_cvtepi32_ps(v), black);
          good = _mm256_cmpgt_epi32(clipped, v);
        } else {
          e = _mm256_i32gather_ps(x.table, _mm256_add_epi32(_mm256_and_si256(v, largest), offsets[k]), 4);
          good = _mm256_cmpgt_epi32(clipped, _mm256_castps_si256(e));  // as integers: positive floats keep their order
        }
        e = _mm256_and_ps(e, _mm256_castsi256_ps(good));
        s0[k] = _mm256_add_ps(s0[k], e);
        s1[k] = _mm256_add_ps(s1[k], _mm256_mul_ps(b1, e));
        s2[k] = _mm256_add_ps(s2[k], _mm256_mul_ps(b2, e));
        usable[k] = _mm256_or_si256(usable[k], _mm256_and_si256(bit, good));
      }
    }
    for (std::size_t k = 0; k < 3; ++k) {
      _mm256_storeu_ps(out.sums[0] + i + 8 * k, s0[k]);
      _mm256_storeu_ps(out.sums[1] + i + 8 * k, s1[k]);
      _mm256_storeu_ps(out.sums[2] + i + 8 * k, s2[k]);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(out.usable + i + 8 * k), usable[k]);
    }
  }
  alignas(32) std::array<std::uint32_t, 8> lanes;
  _mm256_store_si256(reinterpret_cast<__m256i*>(lanes.data()), seen);
  std::uint32_t all = 0;
  for (const std::uint32_t lane : lanes) all |= lane;
  return all;
}
#endif

/// One value; false: left out.
LACQUER_INLINE bool finish_one(const ConstSums& sums, std::size_t i, const FinishTables& t, float* radiance, float* variance,
                               std::uint8_t* flags) {
  const std::uint64_t usable = sums.usable[i] | (sums.usable_high ? std::uint64_t{sums.usable_high[i]} << 32 : 0);
  if (usable == 0 || (usable & (usable + 1)) != 0) return false;
  const std::int32_t count = 64 - __builtin_clzll(usable), channel = t.channels[i % t.period];
  const std::int32_t bin = t.weights.bin_of(sums.sums[2][i] * t.inverse_prediction_time[count - 1] - t.dark_rate);
  const MergeWeight& w = t.weights.at(channel, count, bin);
  const float x = w.a[0] * sums.sums[0][i] + w.a[1] * sums.sums[1][i] + w.a[2] * sums.sums[2][i] - t.dark_rate;
  const float v = t.weights.variance(w, bin, x);
  radiance[i] = x;
  variance[i] = v;
  flags[i] = x * std::abs(x) < v ? 2 : 0;
  return x > t.certain[channel * t.weights.n_exposures + count - 1];
}

#ifdef LACQUER_AVX2
/// 8 values, the same operations; returns a mask of those that are NOT left out.
LACQUER_AVX2 inline std::uint32_t finish_8(const ConstSums& sums, std::size_t i, const FinishTables& t, __m256i channel_row, float* radiance,
                                           float* variance, std::uint8_t* flags) {
  const __m256i one = _mm256_set1_epi32(1), zero = _mm256_setzero_si256();
  const __m256i usable = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(sums.usable + i)), above = _mm256_add_epi32(usable, one);
  // The first ones: usable + 1 is a power of two, whose exponent as a float is their number; 0 and 31 and more are left out.
  const __m256i first_ones = _mm256_and_si256(_mm256_cmpeq_epi32(_mm256_and_si256(usable, above), zero), _mm256_cmpgt_epi32(usable, zero));
  __m256i last = _mm256_sub_epi32(_mm256_srli_epi32(_mm256_castps_si256(_mm256_cvtepi32_ps(above)), 23), _mm256_set1_epi32(128));
  last = _mm256_and_si256(last, first_ones);
  const __m256 s0 = _mm256_loadu_ps(sums.sums[0] + i), s1 = _mm256_loadu_ps(sums.sums[1] + i), s2 = _mm256_loadu_ps(sums.sums[2] + i);
  const __m256 dark = _mm256_set1_ps(t.dark_rate);
  const __m256 near = _mm256_sub_ps(_mm256_mul_ps(s2, _mm256_i32gather_ps(t.inverse_prediction_time, last, 4)), dark);
  const __m256i first_bin = _mm256_set1_epi32(t.weights.first_bin - 1);
  __m256i bin = _mm256_sub_epi32(_mm256_srai_epi32(_mm256_castps_si256(near), MergeWeightTable::bin_shift), first_bin);
  bin = _mm256_min_epi32(_mm256_max_epi32(bin, zero), _mm256_set1_epi32(t.weights.n_bins - 1));
  const __m256i row = _mm256_add_epi32(channel_row, last);
  const __m256i entry = _mm256_slli_epi32(_mm256_add_epi32(_mm256_mullo_epi32(row, _mm256_set1_epi32(t.weights.n_bins)), bin), 3);
  const float* entries = t.weights.entries->a.data();
  static_assert(sizeof(MergeWeight) == 8 * sizeof(float) && offsetof(MergeWeight, variance0) == 16 && offsetof(MergeWeight, variance1) == 20);
  __m256 x = _mm256_mul_ps(_mm256_i32gather_ps(entries, entry, 4), s0);
  x = _mm256_add_ps(x, _mm256_mul_ps(_mm256_i32gather_ps(entries + 1, entry, 4), s1));
  x = _mm256_sub_ps(_mm256_add_ps(x, _mm256_mul_ps(_mm256_i32gather_ps(entries + 2, entry, 4), s2)), dark);
  const __m256i edge = _mm256_slli_epi32(_mm256_add_epi32(bin, first_bin), MergeWeightTable::bin_shift);
  const __m256 low = _mm256_castsi256_ps(_mm256_andnot_si256(_mm256_cmpeq_epi32(bin, zero), edge));
  const __m256 high = _mm256_castsi256_ps(_mm256_add_epi32(edge, _mm256_set1_epi32(1 << MergeWeightTable::bin_shift)));
  const __m256 within = _mm256_max_ps(_mm256_min_ps(x, high), low);
  const __m256 v = _mm256_add_ps(_mm256_i32gather_ps(entries + 4, entry, 4), _mm256_mul_ps(_mm256_i32gather_ps(entries + 5, entry, 4), within));
  _mm256_storeu_ps(radiance + i, x);
  _mm256_storeu_ps(variance + i, v);
  const __m256 squared = _mm256_mul_ps(x, _mm256_andnot_ps(_mm256_set1_ps(-0.0f), x));
  const auto dark_mask = static_cast<std::uint32_t>(_mm256_movemask_ps(_mm256_cmp_ps(squared, v, _CMP_LT_OQ)));
  for (std::uint32_t k = 0; k < 8; ++k) flags[i + k] = static_cast<std::uint8_t>((dark_mask >> k & 1) << 1);
  const __m256 certain = _mm256_cmp_ps(x, _mm256_i32gather_ps(t.certain, row, 4), _CMP_GT_OQ);
  return static_cast<std::uint32_t>(_mm256_movemask_ps(_mm256_and_ps(certain, _mm256_castsi256_ps(first_ones))));
}

/// All blocks of 24 values; sets `done` to the number of values looked at.
LACQUER_AVX2 std::size_t finish_avx2(const ConstSums& sums, std::size_t n, const FinishTables& t, float* radiance, float* variance,
                                     std::uint8_t* flags, std::uint16_t* left_out, std::size_t& done) {
  __m256i rows[3];
  for (std::size_t k = 0; k < 3; ++k) {
    alignas(32) std::array<std::int32_t, 8> lane;
    for (std::size_t i = 0; i < 8; ++i) lane[i] = t.channels[(k * 8 + i) % t.period] * t.weights.n_exposures;
    rows[k] = _mm256_load_si256(reinterpret_cast<const __m256i*>(lane.data()));
  }
  std::size_t n_left = 0;
  for (done = 0; done + block <= n; done += block)
    for (std::size_t k = 0; k < 3; ++k)
      for (std::uint32_t left = ~finish_8(sums, done + 8 * k, t, rows[k], radiance, variance, flags) & 0xff; left != 0; left &= left - 1)
        left_out[n_left++] = static_cast<std::uint16_t>(done + 8 * k + static_cast<std::size_t>(__builtin_ctz(left)));
  return n_left;
}

const bool has_avx2 = __builtin_cpu_supports("avx2");
#endif

}  // namespace

bool add_exposures(const ExposureValues* exposures, std::size_t n_exposures, std::size_t n, const ValueMeaning& meaning, SumsView out) {
  std::uint32_t seen = 0;
  std::size_t i = 0;
#ifdef LACQUER_AVX2
  if (has_avx2) {
    seen = meaning.linear ? add_avx2<true>(exposures, n_exposures, n, meaning, out) : add_avx2<false>(exposures, n_exposures, n, meaning, out);
    i = n / block * block;
  }
#endif
  for (; i < n; ++i) seen |= add_one(exposures, n_exposures, i, meaning, out);
  return seen <= meaning.largest;
}

std::size_t finish_values(const ConstSums& sums, std::size_t n, const FinishTables& tables, float* radiance, float* variance,
                          std::uint8_t* flags, std::uint16_t* left_out) {
  std::size_t n_left = 0, i = 0;
#ifdef LACQUER_AVX2
  if (has_avx2 && tables.weights.n_exposures <= 30) n_left = finish_avx2(sums, n, tables, radiance, variance, flags, left_out, i);
#endif
  for (; i < n; ++i)
    if (!finish_one(sums, i, tables, radiance, variance, flags)) left_out[n_left++] = static_cast<std::uint16_t>(i);
  return n_left;
}

}  // namespace lacquer::calib
