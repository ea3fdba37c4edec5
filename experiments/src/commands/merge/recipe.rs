//! Merge recipes: YAML in mergekit's shape.
//!
//! `merge_method`, `base_model`, `models` with `parameters`, shared `parameters`, `dtype`. mergekit's names of
//! methods and parameters are accepted where a merger of ours computes the same. What mergekit accepts and we do
//! not is an error that names it.

use std::path::Path;

use advsage::part::Part;
use anyhow::{Context as _, Result, bail, ensure};
use sage_core::files;
use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::greedy_soup::Search;

/// Method whose weights are found by a search.
const GREEDY_SOUP: &str = "greedy-soup";
/// Size limit of a recipe, bytes.
const LIMIT: u64 = 1 << 20;
/// Keys of mergekit's recipes that have no meaning here.
const MERGEKIT_KEYS: [&str; 9] = [
    "slices",
    "modules",
    "tokenizer",
    "tokenizer_source",
    "chat_template",
    "out_dtype",
    "architecture",
    "name",
    "finetune",
];

/// A recipe as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    merge_method: String,
    #[serde(default)]
    base_model: Option<String>,
    models: Vec<WrittenModel>,
    #[serde(default)]
    parameters: Map<String, Value>,
    #[serde(default)]
    dtype: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenModel {
    model: String,
    #[serde(default)]
    parameters: Map<String, Value>,
}

/// A checked recipe.
#[derive(Debug)]
pub(super) struct Recipe {
    /// The merger with its options.
    pub(super) merger: Part,
    /// Weights of the prior.
    pub(super) base: String,
    /// Files of the experts with their weights in the mixture.
    pub(super) models: Vec<(String, f64)>,
    /// The search that finds the weights, if the recipe asks for one.
    pub(super) search: Option<Search>,
}

/// Most models of a recipe, which are held in memory together.
const MOST_MODELS: usize = 64;

impl Recipe {
    /// Reads a recipe. Returns its text as well.
    ///
    /// *Errors*: the file cannot be read; it is no recipe; it uses what only mergekit has.
    pub(super) fn read(file: &Path) -> Result<(Self, String)> {
        let named = || format!("`{}`", file.display());
        let text = files::read_argument_text(file, LIMIT);
        let text = text.with_context(|| format!("cannot read {}", named()))?;
        let recipe = Self::parse(&text).with_context(named)?;
        Ok((recipe, text))
    }

    fn parse(text: &str) -> Result<Self> {
        let value: Value = serde_saphyr::from_str(text).context("it is no YAML")?;
        let keys = value.as_object().context("it is no recipe: expected `merge_method`, `models`, …")?;
        if let Some(key) = MERGEKIT_KEYS.iter().find(|key| keys.contains_key(**key)) {
            bail!("`{key}` is not supported: mergekit has it for language models");
        }
        let written: Written = serde_json::from_value(value)?;
        if let Some(dtype) = written.dtype.as_deref().filter(|dtype| !matches!(*dtype, "float32" | "F32")) {
            bail!("`dtype` is `{dtype}`; weights are merged in float32");
        }
        let base = written.base_model.context("`base_model` is missing: the prior of the experts")?;
        ensure!(!written.models.is_empty(), "`models` is empty; name the experts to merge");
        let count = written.models.len();
        ensure!(
            count <= MOST_MODELS,
            "`models` names {count} files; at most {MOST_MODELS} are merged at once"
        );
        let mut shared = written.parameters;
        let search = (written.merge_method == GREEDY_SOUP).then(|| search(&mut shared)).transpose()?;
        let (name, mut options) = merger(&written.merge_method);
        let normalizes = name == "linear" && shared.get("normalize") != Some(&json!(false));
        let shared_density = shared.remove("density");
        let share = shared.remove("t").map(|t| t.as_f64().context("`t` is no number")).transpose()?;
        own_parameters(name, &mut shared, &mut options)?;
        if let Some(key) = shared.keys().find(|key| options.get(*key).is_some_and(|own| *own != shared[*key]))
        {
            // A method of our own name, such as `slerp`, leaves its option to the recipe.
            ensure!(key == "of", "`{key}` is given twice: by `parameters` and by the method or `lambda`");
        }
        options.extend(shared);
        if share.is_some() {
            ensure!(name == "slerp" && count == 2, "`t` is for slerp of two models; give each a `weight`");
        }
        let mut densities: Vec<f64> = Vec::new();
        let mut models = Vec::with_capacity(count);
        for (k, WrittenModel { model, mut parameters }) in written.models.into_iter().enumerate() {
            let ignores_weights = matches!(name, "model-stock" | "uniform-soup");
            let weight = match (parameters.remove("weight"), share) {
                (Some(_), None) if search.is_some() => {
                    bail!("`{model}` has a `weight`; `{GREEDY_SOUP}` finds the weights")
                }
                (Some(weight), None) => {
                    weight.as_f64().with_context(|| format!("`weight` of `{model}` is no number"))?
                }
                (Some(_), Some(_)) => bail!("`{model}` has a `weight`, and `t` is given as well"),
                (None, Some(t)) => [1.0 - t, t][k],
                (None, None) if ignores_weights || search.is_some() => 1.0 / count as f64,
                (None, None) => bail!("`{model}` has no `weight` in its `parameters`"),
            };
            // As in mergekit: the model's own, the shared one, or all values.
            let density =
                parameters.remove("density").or_else(|| shared_density.clone()).unwrap_or(json!(1.0));
            densities.push(density.as_f64().with_context(|| format!("`density` of `{model}` is no number"))?);
            if let Some(key) = parameters.keys().next() {
                bail!(
                    "the parameter `{key}` of `{model}` is not supported; a model has `weight` and `density`"
                );
            }
            models.push((model, weight));
        }
        ensure!(
            densities.iter().all(|density| *density == densities[0]),
            "`density` differs between the models; one for all is supported"
        );
        if matches!(name, "ties" | "dare") {
            options.insert("density".to_owned(), json!(densities[0]));
        } else {
            ensure!(densities[0] == 1.0, "`density` is for TIES and DARE; `{name}` has none");
        }
        if normalizes {
            let sum: f64 = models.iter().map(|(_, weight)| weight).sum();
            ensure!(sum.is_finite() && sum != 0.0, "the weights sum to {sum}, so they cannot be normalised");
            models.iter_mut().for_each(|(_, weight)| *weight /= sum);
        }
        Ok(Self { merger: Part { name: name.to_owned(), options }, base, models, search })
    }
}

/// Our name of a method, and the options that mergekit's name implies.
fn merger(method: &str) -> (&str, Map<String, Value>) {
    let consensus = |consensus: &str| Map::from_iter([("consensus".to_owned(), json!(consensus))]);
    match method {
        "dare_linear" => ("dare", consensus("none")),
        "dare_ties" => ("dare", consensus("sum")),
        "model_stock" => ("model-stock", Map::new()),
        GREEDY_SOUP => ("linear", Map::new()),
        "task_arithmetic" => ("preference-vector", Map::new()),
        "slerp" => ("slerp", Map::from_iter([("of".to_owned(), json!("weights"))])),
        other => (other, Map::new()),
    }
}

/// Takes the parameters of a greedy soup.
fn search(shared: &mut Map<String, Value>) -> Result<Search> {
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let scenes = match shared.remove("scenes") {
        Some(Value::Array(all)) => all.iter().map(text).collect(),
        one => one.as_ref().and_then(text).map(|one| vec![one]),
    };
    let scenes = scenes.filter(|scenes| !scenes.is_empty()).with_context(|| {
        format!("`{GREEDY_SOUP}` needs the parameter `scenes`: a file or folder of scenes, or a list of them")
    })?;
    let selection = shared.remove("selection").unwrap_or(json!("natural"));
    let mu = shared.remove("mu").unwrap_or(json!(0.5));
    Ok(Search {
        scenes,
        selection: text(&selection).context("`selection` is no name of an objective")?,
        mu: mu.as_f64().filter(|mu| (0.0..=1.0).contains(mu)).context("`mu` is not a number from 0 to 1")?,
    })
}

/// Moves mergekit's shared parameters to our options, or refuses them.
fn own_parameters(
    name: &str,
    shared: &mut Map<String, Value>,
    options: &mut Map<String, Value>,
) -> Result<()> {
    let is_sparse = matches!(name, "ties" | "dare");
    if let Some(scale) = shared.remove("lambda") {
        ensure!(
            is_sparse,
            "`lambda` is the scale of TIES and DARE; the mixture comes from the `weight` of each model"
        );
        options.insert("scale".to_owned(), scale);
    }
    // Values that mergekit's methods can switch and ours cannot.
    let fixed = [("normalize", name == "ties"), ("rescale", name == "dare"), ("int8_mask", false)];
    if name == "linear" {
        shared.remove("normalize");
    }
    for (key, ours) in fixed {
        if let Some(value) = shared.remove(key) {
            ensure!(value == json!(ours), "`{key}: {value}` is not supported; `{name}` has `{key}: {ours}`");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIES: &str = "
merge_method: ties
base_model: waymo
models:
  - model: realistic.safetensors
    parameters: {weight: 0.3, density: 0.5}
  - model: adversarial.safetensors
    parameters: {weight: 0.7, density: 0.5}
parameters:
  lambda: 0.9
  normalize: true
dtype: float32
";

    #[test]
    fn a_recipe_of_mergekit_is_read() {
        let recipe = Recipe::parse(TIES).unwrap();
        assert_eq!(recipe.merger.to_string(), r#"ties{"density":0.5,"scale":0.9}"#);
        assert_eq!((&*recipe.base, recipe.models.len()), ("waymo", 2));
        assert_eq!(recipe.models[1], ("adversarial.safetensors".to_owned(), 0.7));
        let slerp =
            "{merge_method: slerp, base_model: p, models: [{model: a}, {model: b}], parameters: {t: 0.25}}";
        let many: Vec<&str> = vec!["{model: a}"; 65];
        let many = format!("{{merge_method: linear, base_model: p, models: [{}]}}", many.join(", "));
        assert!(Recipe::parse(&many).unwrap_err().to_string().contains("at most 64"));
        let slerp = Recipe::parse(slerp).unwrap();
        assert_eq!(slerp.models, [("a".to_owned(), 0.75), ("b".to_owned(), 0.25)]);
        assert_eq!(slerp.merger.to_string(), r#"slerp{"of":"weights"}"#);
        // As in mergekit, `linear` divides by the sum of the weights, and nothing is dropped by default.
        let sum = "{merge_method: linear, base_model: p, models: [{model: a, parameters: {weight: 1}}, {model: b, parameters: {weight: 3}}]}";
        assert_eq!(Recipe::parse(sum).unwrap().models[1], ("b".to_owned(), 0.75));
        let all = TIES.replace(", density: 0.5", "");
        assert_eq!(Recipe::parse(&all).unwrap().merger.options["density"], 1.0);
        let shared = all.replace("normalize: true", "density: 0.25");
        assert_eq!(Recipe::parse(&shared).unwrap().merger.options["density"], 0.25);
    }

    #[test]
    fn a_greedy_soup_names_its_scenes_and_no_weights() {
        let soup = "{merge_method: greedy-soup, base_model: p, models: [{model: a}, {model: b}], parameters: {scenes: dev, mu: 1}}";
        let recipe = Recipe::parse(soup).unwrap();
        let search = Search { scenes: vec!["dev".to_owned()], selection: "natural".to_owned(), mu: 1.0 };
        assert_eq!((recipe.search, &*recipe.merger.name), (Some(search), "linear"));
        for (change, to, named) in [
            ("scenes: dev, ", "", "needs the parameter `scenes`"),
            ("scenes: dev", "scenes: []", "needs the parameter `scenes`"),
            ("mu: 1", "mu: 2", "`mu` is not a number from 0 to 1"),
            ("{model: a}", "{model: a, parameters: {weight: 1}}", "finds the weights"),
        ] {
            let error = format!("{:#}", Recipe::parse(&soup.replace(change, to)).unwrap_err());
            assert!(error.contains(named), "{to}: {error}");
        }
    }

    #[test]
    fn what_is_not_supported_is_named() {
        let error = |text: &str| format!("{:#}", Recipe::parse(text).unwrap_err());
        for (change, to, named) in [
            ("normalize: true", "normalize: false", "`normalize: false` is not supported"),
            ("normalize: true", "int8_mask: true", "`int8_mask: true` is not supported"),
            ("dtype: float32", "dtype: bfloat16", "`dtype` is `bfloat16`"),
            ("dtype: float32", "slices: []", "`slices` is not supported"),
            ("dtype: float32", "colour: red", "unknown field `colour`"),
            ("{weight: 0.3, density: 0.5}", "{density: 0.5}", "`realistic.safetensors` has no `weight`"),
            ("{weight: 0.3, density: 0.5}", "{weight: 0.3, gamma: 1}", "`gamma` of `realistic.safetensors`"),
            ("{weight: 0.3, density: 0.5}", "{weight: 0.3, density: 0.4}", "`density` differs"),
            ("base_model: waymo\n", "", "`base_model` is missing"),
            ("merge_method: ties", "merge_method: linear", "`lambda` is the scale"),
            ("lambda: 0.9", "lambda: 0.9\n  scale: 0.5", "`scale` is given twice"),
            ("{weight: 0.3, density: 0.5}", "{weight: 0.3}", "`density` differs"),
        ] {
            assert!(TIES.contains(change), "{change}");
            let found = error(&TIES.replace(change, to));
            assert!(found.contains(named), "{to}: {found}");
        }
        assert!(error("[1, 2]").contains("it is no recipe"));
        assert!(error("a: [").contains("it is no YAML"));
    }
}
