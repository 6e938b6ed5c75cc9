#include "libfit/fit.h"
