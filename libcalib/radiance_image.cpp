#include "libcalib/radiance_image.h"
