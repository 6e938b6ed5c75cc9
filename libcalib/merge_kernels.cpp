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
  const std::size_t place = i % meaning.period;
  for (std::size_t j = 0; j < n_exposures; ++j) {
    const ExposureValues& x = exposures[j];
    const std::uint32_t raw = x.values[i];
    seen |= raw;
    const auto v = static_cast<std::int32_t>(raw & meaning.largest);
    if (v >= meaning.clipped[x.shortest][place]) continue;
    float e;
    if (meaning.linear) {
      e = static_cast<float>(v) - meaning.black;
    } else if (meaning.node_shift == 0) {
      e = meaning.tables[place][v];
    } else {
      const std::int32_t node = v >> meaning.node_shift;
      e = meaning.tables[place][2 * node] + static_cast<float>(v - (node << meaning.node_shift)) * meaning.tables[place][2 * node + 1];
    }
    s0 += e;
    s1 += x.basis1 * e;
    s2 += x.basis2 * e;
    usable |= x.bit;
  }
  out.sums[0][i] = s0, out.sums[1][i] = s1, out.sums[2][i] = s2;
  out.usable[i] = usable;
  return seen;
}

#ifdef LACQUER_AVX2
/// Three vectors of 8 values, so that periods of 1, 2 and 3 fit.
constexpr std::size_t block = 24;

enum class Curve { line, table, nodes };

/// Of the values 8 k ... 8 k + 7 of a block.
struct Lanes {
  alignas(32) std::array<std::array<std::int32_t, 8>, 2> clipped;
  alignas(32) std::array<std::int32_t, 8> offset;  ///< into tables[0]
};

/// Tables are read one value at a time: on many processors twice as fast as their gather instruction.
LACQUER_AVX2 LACQUER_INLINE __m256 look_up(const float* table, __m256i index) {
  alignas(32) std::array<std::int32_t, 8> i;
  _mm256_store_si256(reinterpret_cast<__m256i*>(i.data()), index);
  return _mm256_setr_ps(table[i[0]], table[i[1]], table[i[2]], table[i[3]], table[i[4]], table[i[5]], table[i[6]], table[i[7]]);
}

struct NodePairs {
  __m256 value, slope;
};

LACQUER_AVX2 LACQUER_INLINE NodePairs look_up_pairs(const float* table, __m256i index) {
  alignas(32) std::array<std::int32_t, 8> i;
  _mm256_store_si256(reinterpret_cast<__m256i*>(i.data()), index);
  const auto two = [&](std::size_t a, std::size_t b) {  // {value, slope} of a, of b
    const __m128 low = _mm_castpd_ps(_mm_load_sd(reinterpret_cast<const double*>(table + i[a])));
    return _mm_loadh_pi(low, reinterpret_cast<const __m64*>(table + i[b]));
  };
  const __m256 even = _mm256_set_m128(two(4, 5), two(0, 1)), odd = _mm256_set_m128(two(6, 7), two(2, 3));
  return {_mm256_shuffle_ps(even, odd, 0x88), _mm256_shuffle_ps(even, odd, 0xdd)};
}

/// 8 values of all exposures at once; their sums stay in registers.
template <Curve curve>
LACQUER_AVX2 LACQUER_INLINE __m256i add_8(const ExposureValues* exposures, std::size_t n_exposures, std::size_t i, const ValueMeaning& meaning,
                                          const Lanes& lanes, const SumsView& out) {
  __m256 s0 = _mm256_loadu_ps(out.sums[0] + i), s1 = _mm256_loadu_ps(out.sums[1] + i), s2 = _mm256_loadu_ps(out.sums[2] + i);
  __m256i usable = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(out.usable + i)), seen = _mm256_setzero_si256();
  const __m256i largest = _mm256_set1_epi32(static_cast<std::int32_t>(meaning.largest));
  const __m256i offset = _mm256_load_si256(reinterpret_cast<const __m256i*>(lanes.offset.data()));
  const __m128i shift = _mm_cvtsi32_si128(meaning.node_shift);
  for (std::size_t j = 0; j < n_exposures; ++j) {
    const ExposureValues& x = exposures[j];
    const __m256i raw = _mm256_cvtepu16_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(x.values + i)));
    seen = _mm256_or_si256(seen, raw);
    const __m256i v = _mm256_and_si256(raw, largest);
    const __m256i good = _mm256_cmpgt_epi32(_mm256_load_si256(reinterpret_cast<const __m256i*>(lanes.clipped[x.shortest].data())), v);
    if (_mm256_movemask_epi8(good) == 0) continue;  // highlights: usually so from some exposure on
    __m256 e;
    if constexpr (curve == Curve::line) {
      e = _mm256_sub_ps(_mm256_cvtepi32_ps(v), _mm256_set1_ps(meaning.black));
    } else if constexpr (curve == Curve::table) {
      e = look_up(meaning.tables[0], _mm256_add_epi32(v, offset));
    } else {
      const __m256i node = _mm256_srl_epi32(v, shift), rest = _mm256_sub_epi32(v, _mm256_sll_epi32(node, shift));
      const __m256i place = _mm256_add_epi32(_mm256_add_epi32(node, node), offset);
      const NodePairs pairs = look_up_pairs(meaning.tables[0], place);
      e = _mm256_add_ps(pairs.value, _mm256_mul_ps(_mm256_cvtepi32_ps(rest), pairs.slope));
    }
    e = _mm256_and_ps(e, _mm256_castsi256_ps(good));
    s0 = _mm256_add_ps(s0, e);
    s1 = _mm256_add_ps(s1, _mm256_mul_ps(_mm256_set1_ps(x.basis1), e));
    s2 = _mm256_add_ps(s2, _mm256_mul_ps(_mm256_set1_ps(x.basis2), e));
    usable = _mm256_or_si256(usable, _mm256_and_si256(_mm256_set1_epi32(static_cast<std::int32_t>(x.bit)), good));
  }
  _mm256_storeu_ps(out.sums[0] + i, s0);
  _mm256_storeu_ps(out.sums[1] + i, s1);
  _mm256_storeu_ps(out.sums[2] + i, s2);
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(out.usable + i), usable);
  return seen;
}

template <Curve curve>
LACQUER_AVX2 std::uint32_t add_avx2(const ExposureValues* exposures, std::size_t n_exposures, std::size_t n, const ValueMeaning& meaning,
                                    const SumsView& out) {
  std::array<Lanes, 3> lanes;
  for (std::size_t k = 0; k < block; ++k) {
    const std::size_t place = k % meaning.period;
    for (std::size_t shortest = 0; shortest < 2; ++shortest) lanes[k / 8].clipped[shortest][k % 8] = meaning.clipped[shortest][place];
    lanes[k / 8].offset[k % 8] = curve == Curve::line ? 0 : static_cast<std::int32_t>(meaning.tables[place] - meaning.tables[0]);
  }
  __m256i seen = _mm256_setzero_si256();
  for (std::size_t i = 0; i + block <= n; i += block)
    for (std::size_t k = 0; k < 3; ++k) seen = _mm256_or_si256(seen, add_8<curve>(exposures, n_exposures, i + 8 * k, meaning, lanes[k], out));
  alignas(32) std::array<std::uint32_t, 8> lane;
  _mm256_store_si256(reinterpret_cast<__m256i*>(lane.data()), seen);
  std::uint32_t all = 0;
  for (const std::uint32_t x : lane) all |= x;
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
  return x > w.certain;
}

#ifdef LACQUER_AVX2
/// The members of 8 entries, each in one vector: loading them whole and transposing costs a third of gathering them.
struct Columns {
  __m256 a0, a1, a2, variance0, variance1, certain;
};

LACQUER_AVX2 LACQUER_INLINE Columns load_weights(const MergeWeight* entries, const std::array<std::int32_t, 8>& index) {
  static_assert(sizeof(MergeWeight) == 8 * sizeof(float) && offsetof(MergeWeight, variance0) == 16 && offsetof(MergeWeight, variance1) == 20 &&
                offsetof(MergeWeight, certain) == 28);
  __m256 low[4], high[4];  // of the entries 2 k and 2 k + 1: {a0 a0 a1 a1 v0 v0 v1 v1}, {a2 a2 - - - - certain certain}
  for (std::size_t k = 0; k < 4; ++k) {
    const __m256 even = _mm256_loadu_ps(entries[index[2 * k]].a.data()), odd = _mm256_loadu_ps(entries[index[2 * k + 1]].a.data());
    low[k] = _mm256_unpacklo_ps(even, odd);
    high[k] = _mm256_unpackhi_ps(even, odd);
  }
  const __m256 first[2] = {_mm256_shuffle_ps(low[0], low[1], 0x44), _mm256_shuffle_ps(low[2], low[3], 0x44)};
  const __m256 second[2] = {_mm256_shuffle_ps(low[0], low[1], 0xee), _mm256_shuffle_ps(low[2], low[3], 0xee)};
  const __m256 third[2] = {_mm256_shuffle_ps(high[0], high[1], 0x44), _mm256_shuffle_ps(high[2], high[3], 0x44)};
  const __m256 fourth[2] = {_mm256_shuffle_ps(high[0], high[1], 0xee), _mm256_shuffle_ps(high[2], high[3], 0xee)};
  return {_mm256_permute2f128_ps(first[0], first[1], 0x20),   _mm256_permute2f128_ps(second[0], second[1], 0x20),
          _mm256_permute2f128_ps(third[0], third[1], 0x20),   _mm256_permute2f128_ps(first[0], first[1], 0x31),
          _mm256_permute2f128_ps(second[0], second[1], 0x31), _mm256_permute2f128_ps(fourth[0], fourth[1], 0x31)};
}

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
  alignas(32) std::array<std::int32_t, 8> entry;
  _mm256_store_si256(reinterpret_cast<__m256i*>(entry.data()),
                     _mm256_add_epi32(_mm256_mullo_epi32(row, _mm256_set1_epi32(t.weights.n_bins)), bin));
  const Columns w = load_weights(t.weights.entries, entry);
  __m256 x = _mm256_mul_ps(w.a0, s0);
  x = _mm256_add_ps(x, _mm256_mul_ps(w.a1, s1));
  x = _mm256_sub_ps(_mm256_add_ps(x, _mm256_mul_ps(w.a2, s2)), dark);
  const __m256i edge = _mm256_slli_epi32(_mm256_add_epi32(bin, first_bin), MergeWeightTable::bin_shift);
  const __m256 low = _mm256_castsi256_ps(_mm256_andnot_si256(_mm256_cmpeq_epi32(bin, zero), edge));
  const __m256 high = _mm256_castsi256_ps(_mm256_add_epi32(edge, _mm256_set1_epi32(1 << MergeWeightTable::bin_shift)));
  const __m256 within = _mm256_max_ps(_mm256_min_ps(x, high), low);
  const __m256 v = _mm256_add_ps(w.variance0, _mm256_mul_ps(w.variance1, within));
  _mm256_storeu_ps(radiance + i, x);
  _mm256_storeu_ps(variance + i, v);
  const __m256 squared = _mm256_mul_ps(x, _mm256_andnot_ps(_mm256_set1_ps(-0.0f), x));
  const __m256i is_dark = _mm256_and_si256(_mm256_castps_si256(_mm256_cmp_ps(squared, v, _CMP_LT_OQ)), _mm256_set1_epi32(2));
  const __m128i words = _mm_packs_epi32(_mm256_castsi256_si128(is_dark), _mm256_extracti128_si256(is_dark, 1));
  _mm_storel_epi64(reinterpret_cast<__m128i*>(flags + i), _mm_packs_epi16(words, words));
  const __m256 certain = _mm256_cmp_ps(x, w.certain, _CMP_GT_OQ);
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
    const auto add = meaning.linear ? add_avx2<Curve::line> : (meaning.node_shift == 0 ? add_avx2<Curve::table> : add_avx2<Curve::nodes>);
    seen = add(exposures, n_exposures, n, meaning, out);
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
