//! `sage list`: what the registries hold.

use std::io::Write;

use anyhow::Result;
use sage_core::registry::Registry;
use serde_json::json;

use crate::{Outcome, Registries};

pub(crate) fn run(registries: &Registries, as_json: bool) -> Result<Outcome> {
    let mut out = std::io::stdout().lock();
    print(&mut out, &registries.rewards, as_json)?;
    print(&mut out, &registries.feasibilities, as_json)?;
    print(&mut out, &registries.backbones, as_json)?;
    print(&mut out, &registries.mergers, as_json)?;
    print(&mut out, &registries.methods, as_json)?;
    Ok(Outcome::Done)
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
            writeln!(out, "  {:<22} {}", entry.name, entry.summary)?;
            let options = entry.defaults.as_object().filter(|options| !options.is_empty());
            if let Some(options) = options {
                let words: Vec<String> =
                    options.iter().map(|(key, value)| format!("{key} = {value}")).collect();
                writeln!(out, "  {:<22}   options: {}", "", words.join(", "))?;
            }
        }
    }
    Ok(())
}
