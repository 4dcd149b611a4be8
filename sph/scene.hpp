// From a case file and a law to a resolved set-up: the scenes that exist, their parameter tables, their first
// particles.
#pragma once

#include <vector>

#include "sph/base/case_file.hpp"
#include "sph/setup.hpp"

namespace dem2sph {

/// Tables of the sections that the solver reads: [flow], [column], [incline], [law].
std::vector<const ParameterTable*> flow_tables();

/// The law that the case file itself gives in its section [law]. Throws UsageError if there is none.
LawFile law_of_case(const CaseFile& file);

/// 2 or 3.
int flow_dimension(const CaseFile& file);

/// Resolves the flow of a case with a law. Throws UsageError for keys that are wrong, or that change nothing.
template <int Dim>
FlowSetup<Dim> make_setup(const CaseFile& file, const LawFile& law);

}  // namespace dem2sph
