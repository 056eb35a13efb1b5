// THE list of material models. A new model is one header in models/ and one line here; schema,
// validation, dispatch, bindings, docs rows and contract tests follow from the list.
#pragma once

#include <utility>
#include <variant>

#include "material/models/ashikhmin_shirley.h"
#include "material/models/blinn_phong.h"
#include "material/models/conductor.h"
#include "material/models/cook_torrance.h"
#include "material/models/dielectric.h"
#include "material/models/lambert.h"
#include "material/models/layered.h"
#include "material/models/measured.h"
#include "material/models/microfacet_generator.h"
#include "material/models/mirror.h"
#include "material/models/mix.h"
#include "material/models/null.h"
#include "material/models/oren_nayar.h"
#include "material/models/plastic.h"
#include "material/models/schlick.h"
#include "material/models/thin_dielectric.h"
#include "material/models/ward.h"

namespace matiere {

template <class... Ms>
struct TypeList {
    static constexpr std::size_t kSize = sizeof...(Ms);
    using Models = std::variant<std::monostate, Ms...>;
    using Params = std::variant<std::monostate, typename Ms::Params...>;
};

// clang-format off
template <class R>
using ModelList = TypeList<
    Lambert<R>,
    Plastic<R>,
    Conductor<R>,
    CookTorrance<R>,
    Dielectric<R>,
    Layered<R>,
    Measured<R>,
    ThinDielectric<R>,
    MicrofacetGenerator<R>,
    Mirror<R>,
    Mix<R>,
    NullModel<R>,
    OrenNayar<R>,
    BlinnPhong<R>,
    AshikhminShirley<R>,
    Ward<R>,
    Schlick<R>
>;
// clang-format on

/// Any model of the list, or none yet.
template <class R>
using AnyModel = typename ModelList<R>::Models;
template <class R>
using AnyParams = typename ModelList<R>::Params;

namespace detail {
template <class... Ms, class F>
void for_each_model(TypeList<Ms...>, F&& f) {
    (f(std::type_identity<Ms>{}), ...);
}

template <std::size_t I, class V, class F>
decltype(auto) visit_from(V& v, F&& f) {
    if constexpr (I + 1 < std::variant_size_v<std::remove_const_t<V>>)
        if (v.index() != I) return visit_from<I + 1>(v, std::forward<F>(f));
    return f(*std::get_if<I>(&v));
}
}  // namespace detail

/// Calls f(std::type_identity<M>) for every model M of the list.
template <class R, class F>
void for_each_model(F&& f) {
    detail::for_each_model(ModelList<R>{}, std::forward<F>(f));
}

/// Calls f with the alternative held, which must not be monostate: a chain of compares that the
/// compiler turns into a jump, cheapest for the first models of the list.
template <class V, class F>
decltype(auto) visit_model(V& v, F&& f) {
    return detail::visit_from<1>(v, std::forward<F>(f));
}

}  // namespace matiere
