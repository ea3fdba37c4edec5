//! `sage list`: prints the entries of all registries.

use std::io::Write;

use anyhow::Result;
use sage_core::text::wrap::wrapped;
use sage_core::{
    objective::{ObjectiveSpec, PRESETS},
    registry::Registry,
};
use sage_generators::GeneratorKind;
use sage_run::Outcome;
use sage_sim::policy::EgoPolicy;
use serde_json::{Value, json};

use crate::Registries;

pub(crate) fn run(registries: &Registries, as_json: bool) -> Result<Outcome> {
    let mut out = std::io::stdout().lock();
    print(&mut out, &registries.parts.rewards, as_json)?;
    print(&mut out, &registries.parts.feasibilities, as_json)?;
    objectives(&mut out, as_json)?;
    print(&mut out, &registries.parts.backbones, as_json)?;
    print(&mut out, &registries.parts.mergers, as_json)?;
    generators(&mut out, &registries.parts.generators, as_json)?;
    policies(&mut out, &registries.parts.policies, as_json)?;
    print(&mut out, &registries.parts.curricula, as_json)?;
    print(&mut out, &registries.parts.scene_samplers, as_json)?;
    print(&mut out, &registries.parts.driving_rewards, as_json)?;
    print(&mut out, &registries.claims, as_json)?;
    Ok(Outcome::Done)
}

/// Presets that `--selection` and `finetune --config` accept by name.
fn objectives(out: &mut impl Write, as_json: bool) -> Result<()> {
    if !as_json {
        writeln!(out, "objective (--selection NAME, or a JSON file)")?;
    }
    for (name, summary) in PRESETS {
        if as_json {
            let spec = ObjectiveSpec::preset(name);
            writeln!(
                out,
                "{}",
                json!({"kind": "objective", "name": name, "summary": summary, "spec": spec})
            )?;
        } else {
            line(out, name, summary)?;
        }
    }
    Ok(())
}

/// Generators, with the information that each uses beyond *now*.
fn generators(out: &mut impl Write, registry: &Registry<dyn GeneratorKind>, as_json: bool) -> Result<()> {
    if !as_json {
        writeln!(out, "{}", registry.kind())?;
    }
    for entry in registry.entries() {
        let knows = registry.build_default(entry.name)?.facts().knows.to_string();
        if as_json {
            let row = json!({
                "kind": registry.kind(), "name": entry.name, "summary": entry.summary,
                "source": entry.source, "options": entry.defaults, "knows": knows,
            });
            writeln!(out, "{row}")?;
        } else {
            line(out, entry.name, entry.summary)?;
            line(out, "", &format!("  knows: {knows}"))?;
            options(out, &entry.defaults)?;
        }
    }
    Ok(())
}

/// Driving policies, with what each knows beyond its view. A policy whose options have no default that works
/// names them alone.
fn policies(out: &mut impl Write, registry: &Registry<dyn EgoPolicy>, as_json: bool) -> Result<()> {
    if !as_json {
        writeln!(out, "{}", registry.kind())?;
    }
    for entry in registry.entries() {
        let knows = registry.build_default(entry.name).map(|policy| policy.knows()).unwrap_or_default();
        if as_json {
            let row = json!({
                "kind": registry.kind(), "name": entry.name, "summary": entry.summary,
                "source": entry.source, "options": entry.defaults, "knows": knows.to_string(),
            });
            writeln!(out, "{row}")?;
        } else {
            line(out, entry.name, entry.summary)?;
            line(out, "", &format!("  knows: {knows}"))?;
            options(out, &entry.defaults)?;
        }
    }
    Ok(())
}

fn print<T: ?Sized>(out: &mut impl Write, registry: &Registry<T>, as_json: bool) -> Result<()> {
    if !as_json {
        writeln!(out, "{}", registry.kind())?;
    }
    for entry in registry.entries() {
        if as_json {
            let row = json!({
                "kind": registry.kind(), "name": entry.name, "summary": entry.summary,
                "source": entry.source, "options": entry.defaults,
            });
            writeln!(out, "{row}")?;
        } else {
            line(out, entry.name, entry.summary)?;
            options(out, &entry.defaults)?;
        }
    }
    Ok(())
}

/// A name with words, in lines that fit a terminal.
fn line(out: &mut impl Write, name: &str, words: &str) -> Result<()> {
    Ok(writeln!(out, "{}", wrapped(&format!("  {name:<22} {words}"), 27))?)
}

fn options(out: &mut impl Write, defaults: &Value) -> Result<()> {
    let options = defaults.as_object().filter(|options| !options.is_empty());
    if let Some(options) = options {
        let words: Vec<String> =
            options.iter().map(|(key, value)| format!("{key} = {}", short(value))).collect();
        line(out, "", &format!("  options: {}", words.join(", ")))?;
    }
    Ok(())
}

/// A value with the fewest digits that give it back: options of 32 bits have long decimals in 64.
fn short(value: &Value) -> String {
    match (value, value.as_f64().filter(|_| value.is_f64())) {
        (_, Some(number)) if f64::from(number as f32) == number => format!("{:?}", number as f32),
        // With spaces, so that a long one can be broken.
        (Value::Object(fields), _) => {
            let fields: Vec<String> =
                fields.iter().map(|(key, value)| format!("\"{key}\": {}", short(value))).collect();
            format!("{{{}}}", fields.join(", "))
        }
        _ => value.to_string(),
    }
}
