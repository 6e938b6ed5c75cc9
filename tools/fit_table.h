#pragma once

#include <string>
#include <vector>

#include "libfit/fit.h"

namespace lacquer::tools {

struct NamedFit {
  std::string name;  ///< of the paint
  fit::FitResult fit;
};

enum class TableFormat { csv, markdown, latex };

/// By the file's extension: .csv, .md, .tex; Error{usage} for another.
TableFormat table_format(const std::string& file);

/// Parameters of several paints with standard errors. CSV: a paint a row, a column each for value and standard error of every parameter.
/// Markdown and LaTeX as Table 1 of Günther et al. 2005: a row for each channel of a paint; m and r in the first.
std::string fit_table_text(const std::vector<NamedFit>& fits, TableFormat format);

/// Value with its standard error: as many digits as the first two of the error, e.g. "0.05498 ± 0.00021".
std::string with_error(double value, double sigma, const char* sign = "±");
/// The same for columns of a table: the sign below the sign above, `before` columns before it and `after` behind.
std::string with_error_aligned(double value, double sigma, int before, int after);

}  // namespace lacquer::tools
