// Light that a Lambert body under a smooth absorbing coat gets back from the coat's underside.
#pragma once

namespace matiere {

/// 2 * integral over mu of F(mu) exp(-2 tau / mu) mu dmu, F the reflectance from inside a coat of
/// index `eta`, tau its optical depth along the normal. For tau = 0 this is
/// 1 - (1 - F_ex) / eta^2, F_ex the average from outside (Weidlich & Wilkie 2007, corrected).
double coat_return(double eta, double tau);

}  // namespace matiere
