#include "libacquire/aravis/genicam_formats.h"

#include <array>

namespace lacquer::acquire {

namespace {

using L = PixelLayout;
using P = Packing;

/// Codes: PFNC 2.4 and GigE Vision 1.2. Layouts with the same depth are ordered by preference.
constexpr std::array formats{
    GenicamFormat{"Mono8", 0x01080001, L::mono, 8, P::bytes},
    GenicamFormat{"Mono10", 0x01100003, L::mono, 10, P::words_le},
    GenicamFormat{"Mono10p", 0x010A0046, L::mono, 10, P::stream_10},
    GenicamFormat{"Mono10Packed", 0x010C0004, L::mono, 10, P::gige_10},
    GenicamFormat{"Mono12", 0x01100005, L::mono, 12, P::words_le},
    GenicamFormat{"Mono12p", 0x010C0047, L::mono, 12, P::stream_12},
    GenicamFormat{"Mono12Packed", 0x010C0006, L::mono, 12, P::gige_12},
    GenicamFormat{"Mono14", 0x01100025, L::mono, 14, P::words_le},
    GenicamFormat{"Mono16", 0x01100007, L::mono, 16, P::words_le},
    GenicamFormat{"BayerGR8", 0x01080008, L::bayer_grbg, 8, P::bytes},
    GenicamFormat{"BayerRG8", 0x01080009, L::bayer_rggb, 8, P::bytes},
    GenicamFormat{"BayerGB8", 0x0108000A, L::bayer_gbrg, 8, P::bytes},
    GenicamFormat{"BayerBG8", 0x0108000B, L::bayer_bggr, 8, P::bytes},
    GenicamFormat{"BayerGR10", 0x0110000C, L::bayer_grbg, 10, P::words_le},
    GenicamFormat{"BayerRG10", 0x0110000D, L::bayer_rggb, 10, P::words_le},
    GenicamFormat{"BayerGB10", 0x0110000E, L::bayer_gbrg, 10, P::words_le},
    GenicamFormat{"BayerBG10", 0x0110000F, L::bayer_bggr, 10, P::words_le},
    GenicamFormat{"BayerGR10p", 0x010A0056, L::bayer_grbg, 10, P::stream_10},
    GenicamFormat{"BayerRG10p", 0x010A0058, L::bayer_rggb, 10, P::stream_10},
    GenicamFormat{"BayerGB10p", 0x010A0054, L::bayer_gbrg, 10, P::stream_10},
    GenicamFormat{"BayerBG10p", 0x010A0052, L::bayer_bggr, 10, P::stream_10},
    GenicamFormat{"BayerGR10Packed", 0x010C0026, L::bayer_grbg, 10, P::gige_10},
    GenicamFormat{"BayerRG10Packed", 0x010C0027, L::bayer_rggb, 10, P::gige_10},
    GenicamFormat{"BayerGB10Packed", 0x010C0028, L::bayer_gbrg, 10, P::gige_10},
    GenicamFormat{"BayerBG10Packed", 0x010C0029, L::bayer_bggr, 10, P::gige_10},
    GenicamFormat{"BayerGR12", 0x01100010, L::bayer_grbg, 12, P::words_le},
    GenicamFormat{"BayerRG12", 0x01100011, L::bayer_rggb, 12, P::words_le},
    GenicamFormat{"BayerGB12", 0x01100012, L::bayer_gbrg, 12, P::words_le},
    GenicamFormat{"BayerBG12", 0x01100013, L::bayer_bggr, 12, P::words_le},
    GenicamFormat{"BayerGR12p", 0x010C0057, L::bayer_grbg, 12, P::stream_12},
    GenicamFormat{"BayerRG12p", 0x010C0059, L::bayer_rggb, 12, P::stream_12},
    GenicamFormat{"BayerGB12p", 0x010C0055, L::bayer_gbrg, 12, P::stream_12},
    GenicamFormat{"BayerBG12p", 0x010C0053, L::bayer_bggr, 12, P::stream_12},
    GenicamFormat{"BayerGR12Packed", 0x010C002A, L::bayer_grbg, 12, P::gige_12},
    GenicamFormat{"BayerRG12Packed", 0x010C002B, L::bayer_rggb, 12, P::gige_12},
    GenicamFormat{"BayerGB12Packed", 0x010C002C, L::bayer_gbrg, 12, P::gige_12},
    GenicamFormat{"BayerBG12Packed", 0x010C002D, L::bayer_bggr, 12, P::gige_12},
    GenicamFormat{"BayerGR16", 0x0110002E, L::bayer_grbg, 16, P::words_le},
    GenicamFormat{"BayerRG16", 0x0110002F, L::bayer_rggb, 16, P::words_le},
    GenicamFormat{"BayerGB16", 0x01100030, L::bayer_gbrg, 16, P::words_le},
    GenicamFormat{"BayerBG16", 0x01100031, L::bayer_bggr, 16, P::words_le},
};

}  // namespace

const GenicamFormat* genicam_format(std::string_view name) {
  for (const GenicamFormat& f : formats)
    if (f.name == name) return &f;
  return nullptr;
}

std::vector<const GenicamFormat*> genicam_formats(PixelLayout layout, int bits) {
  std::vector<const GenicamFormat*> result;
  for (const GenicamFormat& f : formats)
    if (f.layout == layout && f.bits == bits) result.push_back(&f);
  return result;
}

}  // namespace lacquer::acquire
