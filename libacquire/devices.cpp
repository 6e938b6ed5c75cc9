#include "libacquire/devices.h"
