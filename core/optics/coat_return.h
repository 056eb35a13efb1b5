// Light that a Lambert body under a smooth absorbing coat does not get back from its underside.
#pragma once

namespace matiere {

/// 1 - r with r = 2 * integral over mu of F(mu) exp(-2 tau / mu) mu dmu, F the reflectance from
/// inside a coat of index `eta`, tau its optical depth along the normal; a sum of positive parts,
/// since all the light may come back. For tau = 0 this is (1 - F_ex) / eta^2, F_ex the average from
/// outside (Weidlich & Wilkie 2007, corrected).
double coat_escape(double eta, double tau);

}  // namespace matiere
