#include "material/record.h"

#include <cmath>
#include <string>

#include "base/error.h"
#include "material/schema.h"

namespace matiere {
namespace {

std::string number_text(double v) {
    std::string s = std::to_string(v);
    s.erase(s.find_last_not_of('0') + 1);
    if (!s.empty() && s.back() == '.') s.pop_back();
    return v != 0.0 && std::abs(v) < 1e-6 ? "tiny" : s;
}

std::string range_text(const ParamInfo& info) {
    const std::string low = (info.min_exclusive ? "above " : "at least ") + number_text(info.min);
    const std::string high = std::isinf(info.max) ? "" : " and at most " + number_text(info.max);
    return low + high + (info.reason.empty() ? "" : ": " + std::string(info.reason));
}

/// Reads the values of one material, with errors that point at the parameter.
class Reader {
 public:
    Reader(const MaterialDescription& d, const TextureTable& textures)
        : d_(d), textures_(textures) {}

    [[noreturn]] void fail(const std::string& code, const std::string& message,
                           std::string_view param = {}) const {
        const std::string tail = param.empty() ? "" : "/" + std::string(param);
        throw SceneError(code, message, d_.pointer + tail);
    }

    const TextureTable& textures() const { return textures_; }

    const ParamValue* find(std::string_view name) const {
        const auto it = d_.params.find(std::string(name));
        return it == d_.params.end() ? nullptr : &it->second;
    }

    void check_range(const ParamInfo& info, double v) const {
        if (std::isfinite(v) && v <= info.max &&
            (info.min_exclusive ? v > info.min : v >= info.min))
            return;
        fail("out_of_range",
             std::string(info.name) + " is " + number_text(v) + "; it must be " + range_text(info),
             info.name);
    }

    /// The texture named by a value, its extremes checked against the range; -1 for a constant.
    int texture(const ParamInfo& info, const ParamValue& value) const {
        const auto* ref = std::get_if<TextureRef>(&value);
        if (!ref) return -1;
        if (info.constant_only)
            fail("no_texture", std::string(info.name) + " takes a constant, not a texture",
                 info.name);
        if (ref->index < 0 || ref->index >= textures_.size())
            fail("unknown_texture", "no texture has the index " + std::to_string(ref->index),
                 info.name);
        const ImageTexture& image = textures_[ref->index];
        const int lanes = info.kind == ParamKind::kColor ? kActiveLanes : 1;
        for (int i = 0; i < lanes; ++i) {
            check_range(info, double(image.minimum()[i]));
            check_range(info, double(image.maximum()[i]));
        }
        return ref->index;
    }

    double number(const ParamInfo& info, const ParamValue& value) const {
        if (const auto* v = std::get_if<double>(&value)) return check_range(info, *v), *v;
        fail("wrong_type", std::string(info.name) + " must be a number", info.name);
    }

    std::array<double, 3> colour(const ParamInfo& info, const ParamValue& value) const {
        std::array<double, 3> rgb{};
        if (const auto* v = std::get_if<double>(&value))
            rgb = {*v, *v, *v};
        else if (const auto* c = std::get_if<std::array<double, 3>>(&value))
            rgb = *c;
        else
            fail("wrong_type", std::string(info.name) + " must be a number or [r, g, b]",
                 info.name);
        for (const double v : rgb) check_range(info, v);
        return rgb;
    }

    int list_size(const ParamInfo& info, const ParamValue& value) const {
        const auto* size = std::get_if<ListSize>(&value);
        if (!size)
            fail("wrong_type", std::string(info.name) + " must be a list of objects", info.name);
        check_range(info, size->count);
        return size->count;
    }

    int choice(const ParamInfo& info, const ParamValue& value) const {
        if (info.kind == ParamKind::kList) return list_size(info, value);
        if (info.kind == ParamKind::kBool) {
            if (const auto* b = std::get_if<bool>(&value)) return *b ? 1 : 0;
            fail("wrong_type", std::string(info.name) + " must be true or false", info.name);
        }
        const auto* word = std::get_if<std::string>(&value);
        std::string known;
        for (std::size_t i = 0; i < info.choices.size(); ++i) {
            if (word && *word == info.choices[i]) return int(i);
            known += (i ? ", " : "") + std::string(info.choices[i]);
        }
        fail(word ? "bad_choice" : "wrong_type",
             std::string(info.name) + " must be one of " + known, info.name);
    }

 private:
    const MaterialDescription& d_;
    const TextureTable& textures_;
};

/// The recipe of a nested material; null where it is not given.
template <class R>
std::unique_ptr<ModelRecipe<R>> nested_recipe(const Reader& reader, const MaterialDescription& d,
                                              const ParamInfo& info, TableStore<R>& tables) {
    const ParamValue* value = reader.find(info.name);
    if (!value) return nullptr;
    const auto* given = std::get_if<NestedDescription>(value);
    if (!given || !*given)
        reader.fail("wrong_type", std::string(info.name) + " must be a material", info.name);
    MaterialDescription child = **given;
    child.pointer = d.pointer + "/" + std::string(info.name);
    return std::make_unique<ModelRecipe<R>>(make_recipe<R>(child, reader.textures(), tables));
}

template <class R>
void check_nested(const Reader& reader, const ModelRecipe<R>& recipe) {
    if (recipe.nested_count() > kMaxNested)
        reader.fail("too_many", "more than " + std::to_string(kMaxNested) +
                                    " materials are nested in this one");
    int interfaces = 0;
    for (const auto& slot : recipe.nested) interfaces += slot.recipe->interface() ? 1 : 0;
    if (interfaces > 1)
        reader.fail("out_of_range",
                    "two of the nested materials bound a medium; only one may, as the inside of "
                    "a shape is of one medium");
}

/// Which kinds of rows a parameter struct has: code for the others is not even compiled.
template <class P>
struct Rows {
    template <class F>
    static constexpr bool any(F&& f) {
        for (const auto& row : P::table())
            if (f(row)) return true;
        return false;
    }
    static constexpr bool kScalar = any([](const auto& r) { return r.scalar != nullptr; });
    static constexpr bool kColor = any([](const auto& r) { return r.color != nullptr; });
    static constexpr bool kChoice = any([](const auto& r) { return r.choice != nullptr; });
    static constexpr bool kNested = any([](const auto& r) { return r.nested != nullptr; });
    static constexpr bool kData = any([](const auto& r) { return r.data != nullptr; });
};

/// Fills one row's member; returns the texture that will overwrite it at hits, or -1.
template <class P, class R>
int fill(const Reader& reader, const Param<P, R>& row, P& params) {
    const ParamInfo& info = row.info;
    const ParamValue* value = reader.find(info.name);
    if (info.required && !value)
        reader.fail("missing", std::string(info.name) + " must be given", info.name);
    if (row.nested) return -1;
    if (info.kind == ParamKind::kMetal) {
        if (value)
            reader.fail("unresolved_metal", "a metal's name must be resolved to eta and k first",
                        info.name);
        return -1;
    }
    if constexpr (Rows<P>::kData)
        if (row.data) {
            const auto* file = value ? std::get_if<DataRef>(value) : nullptr;
            if (value && (!file || !*file))
                reader.fail("wrong_type", std::string(info.name) + " must be the arrays of a file",
                            info.name);
            if (file) params.*(row.data) = {file->get(), true, false};
            return -1;
        }
    const int texture = value ? reader.texture(info, *value) : -1;
    const bool constant = value && texture < 0;
    const auto mark = [&](auto& member) {
        member.given = value != nullptr;
        member.textured = texture >= 0;
    };
    if constexpr (Rows<P>::kScalar)
        if (row.scalar) {
            auto& member = params.*(row.scalar);
            member.v = R(constant ? reader.number(info, *value) : info.default_value);
            mark(member);
        }
    if constexpr (Rows<P>::kColor)
        if (row.color) {
            auto& member = params.*(row.color);
            member.v = Spectrum<R>(R(info.default_value));
            if (constant) {
                const auto c = reader.colour(info, *value);
                member.v = {R(c[0]), R(c[1]), R(c[2])};
            }
            mark(member);
        }
    if constexpr (Rows<P>::kChoice)
        if (row.choice) {
            auto& member = params.*(row.choice);
            member.v = constant ? reader.choice(info, *value) : int(info.default_value);
            mark(member);
        }
    return texture;
}

void check_rule(const Reader& reader, const Rule& rule) {
    std::size_t given = 0;
    std::string_view first_given, second_given, first_missing;
    std::string names;
    for (std::size_t i = 0; i < rule.size(); ++i) {
        names += (i ? ", " : "") + std::string(rule.names[i]);
        if (!reader.find(rule.names[i])) {
            if (first_missing.empty()) first_missing = rule.names[i];
            continue;
        }
        if (++given == 1) first_given = rule.names[i];
        if (given == 2) second_given = rule.names[i];
    }
    switch (rule.kind) {
        case RuleKind::kExclusive:
            if (given > 1) reader.fail("exclusive", "give only one of " + names, second_given);
            break;
        case RuleKind::kOneOf:
            if (given == 0) reader.fail("missing", "give one of " + names);
            break;
        case RuleKind::kTogether:
            if (given != 0 && given != rule.size())
                reader.fail("missing", "give " + names + " together", first_given);
            break;
        case RuleKind::kRequires:
            if (reader.find(rule.names[0]) && !reader.find(rule.names[1]))
                reader.fail("missing",
                            std::string(rule.names[0]) + " needs " + std::string(rule.names[1]),
                            rule.names[0]);
            break;
    }
}

template <class P>
void check_names(const Reader& reader, const MaterialDescription& d) {
    for (const auto& [name, value] : d.params) {
        bool known = false;
        for (const auto& row : P::table()) known |= row.info.name == name;
        if (!known)
            reader.fail("unknown_parameter", d.type + " has no parameter '" + name + "'", name);
    }
}

template <class P, class R>
void apply_slot(P& params, const TextureSlot& slot, const Spectrum<R>& value) {
    static constexpr auto table = P::table();
    if constexpr (Rows<P>::kScalar)
        if (const auto& row = table[slot.row]; row.scalar) (params.*(row.scalar)).v = value[0];
    if constexpr (Rows<P>::kColor)
        if (const auto& row = table[slot.row]; row.color) (params.*(row.color)).v = value;
}

/// Completes a parameter with a nested model made at the hit.
template <class P, class R>
void apply_nested(P& params, std::uint8_t row, const ModelBox<R>* box) {
    static constexpr auto table = P::table();
    if constexpr (Rows<P>::kNested) (params.*(table[row].nested)).v.box = box;
}

template <class M, class R>
ModelRecipe<R> make_model_recipe(const Reader& reader, const MaterialDescription& d,
                                 const TextureTable& textures, TableStore<R>& tables) {
    using P = typename M::Params;
    check_names<P>(reader, d);
    P params;
    ModelRecipe<R> recipe;
    std::uint8_t index = 0;
    for (const auto& row : P::table()) {
        const int texture = fill(reader, row, params);
        if (texture >= 0) recipe.slots.push_back({index, texture});
        if constexpr (Rows<P>::kNested)
            if (row.nested)
                if (auto child = nested_recipe<R>(reader, d, row.info, tables)) {
                    params.*(row.nested) = {{&child->made}, true, child->textured()};
                    recipe.nested.push_back({index, std::move(child)});
                }
        ++index;
    }
    if constexpr (requires { params.image; })  // read while building, not at hits
        std::erase_if(recipe.slots, [&](const TextureSlot& slot) {
            if (P::table()[slot.row].info.name != P::kImageParam) return false;
            params.image = &textures[slot.texture];
            return true;
        });
    check_nested(reader, recipe);
    for (const Rule& rule : P::rules()) check_rule(reader, rule);
    const auto with_maxima = [&](P p) {
        for (const TextureSlot& slot : recipe.slots)
            apply_slot(p, slot, spectrum_cast<R>(textures[slot.texture].maximum()));
        return p;
    };
    if constexpr (requires { M::check(params); })
        if (const ParamError error = M::check(with_maxima(params)); !error.message.empty())
            reader.fail("out_of_range", std::string(error.message), error.param);
    if constexpr (TabulatedModel<M, R>) M::tabulate(params, tables);
    recipe.params = params;
    recipe.made.model = M::prepare(with_maxima(params));
    return recipe;
}

/// The value of `eta` where it is one; checked when the material is made.
std::optional<Spectrumd> stated_index(const MaterialDescription& d, double initial) {
    const auto it = d.params.find("eta");
    if (it == d.params.end()) return Spectrumd(initial);
    if (const auto* n = std::get_if<double>(&it->second)) return Spectrumd(*n);
    const auto* rgb = std::get_if<std::array<double, 3>>(&it->second);
    if (rgb == nullptr) return {};
    return Spectrumd((*rgb)[0], (*rgb)[1], (*rgb)[2]);
}

}  // namespace

std::vector<Spectrumd> interior_indices(const MaterialDescription& d) {
    std::vector<Spectrumd> found;
    for_each_model<float>([&]<class M>(std::type_identity<M>) {
        if constexpr (InterfaceModel<M, float>) {
            if (d.type != M::kName) return;
            std::optional<double> initial;
            for (const auto& row : M::Params::table())
                if (row.info.name == "eta") initial = row.info.default_value;
            if (!initial) return;  // takes that of its surroundings
            const auto eta = stated_index(d, *initial);
            if (eta && eta->min_value() > 0.0 && eta->is_finite()) found.push_back(*eta);
        }
    });
    for (const auto& [name, value] : d.params)
        if (const auto* nested = std::get_if<NestedDescription>(&value); nested && *nested)
            for (const Spectrumd& eta : interior_indices(**nested)) found.push_back(eta);
    return found;
}

template <class R>
ModelRecipe<R> make_recipe(const MaterialDescription& description, const TextureTable& textures,
                           TableStore<R>& tables) {
    const Reader reader(description, textures);
    ModelRecipe<R> recipe;
    for_each_model<R>([&]<class M>(std::type_identity<M>) {
        static_assert(Model<M, R>);
        if (description.type == M::kName)
            recipe = make_model_recipe<M, R>(reader, description, textures, tables);
    });
    if (recipe.model().index() == 0)
        reader.fail("unknown_material",
                    "no material type '" + description.type + "'; known are " + model_names(),
                    "type");
    return recipe;
}

template <class R>
bool ModelRecipe<R>::textured() const {
    bool any = !slots.empty();
    for (const auto& slot : nested) any |= slot.recipe->textured();
    return any;
}

template <class R>
const ModelRecipe<R>* ModelRecipe<R>::interface() const {
    const ModelRecipe* found = nullptr;
    visit_model(made.model, [&]<class M>(const M& m) {
        if constexpr (requires { m.bounds_medium(); })
            found = m.bounds_medium() ? this : nullptr;
        else if constexpr (InterfaceModel<M, R>)
            found = this;
    });
    for (const auto& slot : nested)
        if (!found) found = slot.recipe->interface();
    return found;
}

template <class R>
std::uint32_t ModelRecipe<R>::features() const {
    std::uint32_t bits = 0;
    visit_model(made.model, [&]<class M>(const M& m) {
        if constexpr (!std::same_as<M, std::monostate>) bits = M::kFeatures;
        // Only a lobe that is wider one way needs the tangent.
        if constexpr (requires { m.is_anisotropic(); })
            if (slots.empty() && !m.is_anisotropic()) bits &= ~std::uint32_t(kFeatureAnisotropic);
    });
    for (const auto& slot : nested) bits |= slot.recipe->features();
    return bits;
}

template <class R>
std::uint8_t ModelRecipe<R>::lobes() const {
    std::uint8_t bits = model_lobes<R>(made.model);
    if (textured())
        for (const auto& slot : nested) bits |= slot.recipe->lobes();
    return bits;
}

template <class R>
int ModelRecipe<R>::nested_count() const {
    int n = 0;
    for (const auto& slot : nested) n += 1 + slot.recipe->nested_count();
    return n;
}

template <class R>
AnyModel<R> ModelRecipe<R>::at(const TextureTable& textures, const TexturePoint& point, R eta_rel,
                               NestedModels<R>& room) const {
    AnyModel<R> at_hit;
    visit_model(made.model, [&]<class M>(const M& m) {
        if constexpr (InterfaceModel<M, R>)
            if (slots.empty() && nested.empty()) {
                at_hit = m.at_interface(eta_rel);
                return;
            }
        if constexpr (!std::same_as<M, std::monostate>) {
            constexpr std::size_t kIndex = AnyModel<R>(std::in_place_type<M>).index();
            auto completed = std::get<kIndex>(params);
            for (const TextureSlot& slot : slots)
                apply_slot(completed, slot, spectrum_cast<R>(textures[slot.texture].lookup(point)));
            for (const NestedSlot<R>& slot : nested)
                if (slot.recipe->textured() || slot.recipe->interface())
                    apply_nested(completed, slot.row,
                                 room.add(slot.recipe->at(textures, point, eta_rel, room)));
            const M prepared = M::prepare(completed);
            if constexpr (InterfaceModel<M, R>)
                at_hit = prepared.at_interface(eta_rel);
            else
                at_hit = prepared;
        }
    });
    return at_hit;
}

template <class R>
BsdfEval<R> Nested<R>::eval(Vec3<R> wo, Vec3<R> wi) const {
    return eval_model(box->model, wo, wi);
}
template <class R>
std::optional<BsdfSample<R>> Nested<R>::sample(Vec3<R> wo, Vec3<R> u) const {
    return sample_model(box->model, wo, u);
}
template <class R>
std::string_view Nested<R>::name() const {
    return visit_model(box->model, []<class M>(const M&) -> std::string_view {
        if constexpr (std::same_as<M, std::monostate>)
            return {};
        else
            return M::kName;
    });
}
template <class R>
std::uint8_t Nested<R>::lobes() const {
    return model_lobes<R>(box->model);
}
template <class R>
Spectrum<R> Nested<R>::diffuse(Vec3<R> wo, Vec3<R> wi) const {
    return model_diffuse<R>(box->model, wo, wi);
}
template <class R>
R Nested<R>::null_share() const {
    return model_null_share<R>(box->model);
}
template <class R>
bool Nested<R>::is_stochastic() const {
    return model_is_stochastic<R>(box->model);
}

template struct Nested<float>;
template struct Nested<double>;
template struct ModelRecipe<float>;
template struct ModelRecipe<double>;
template ModelRecipe<float> make_recipe(const MaterialDescription&, const TextureTable&,
                                        TableStore<float>&);
template ModelRecipe<double> make_recipe(const MaterialDescription&, const TextureTable&,
                                         TableStore<double>&);

}  // namespace matiere
