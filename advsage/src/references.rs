//! Reference drivers by name: those that say whether a contact is preventable.

use sage_sim::reference::{DEFAULT, Reference};
use serde_json::json;

use crate::{Error, Registries, Result, WithContext as _};

/// The default names.
pub fn default_names() -> Vec<String> {
    DEFAULT.map(str::to_owned).to_vec()
}

/// The reference drivers of a test: the named ones without the driver under test, `tested` by its name, since a driver is no
/// reference for itself.
///
/// *Errors*: a name that is not registered or needs options; one that is given twice.
pub fn references(names: &[String], tested: &str, registries: &Registries) -> Result<Vec<Reference>> {
    let mut all: Vec<Reference> = Vec::new();
    for (k, name) in names.iter().enumerate() {
        if names[..k].contains(name) {
            return Err(Error::Value(format!("the reference driver `{name}` is given twice")));
        }
        // Built although it may not be asked: a wrong name is an error for every driver.
        let policy = registries.policies.build(name, &json!({})).with_context(|| {
            format!("`{name}` cannot be a reference driver; expected the name of a policy without options")
        })?;
        if name != tested {
            all.push(Reference { name: name.clone(), policy });
        }
    }
    Ok(all)
}
