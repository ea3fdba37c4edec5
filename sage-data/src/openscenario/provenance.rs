//! Where a scenario comes from, and what may be done with it.

/// Facts on how a scene was made, in the order in which the file states them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Provenance(Vec<[String; 2]>);

impl Provenance {
    /// The same with one more fact, such as `method` and `sage`. A key that is there keeps its place and gets
    /// the new value. The file writes `sage:` before each key.
    #[must_use]
    pub fn with(mut self, key: impl Into<String>, value: impl Into<String>) -> Self {
        let (key, value) = (key.into(), value.into());
        match self.0.iter_mut().find(|fact| fact[0] == key) {
            Some(fact) => fact[1] = value,
            None => self.0.push([key, value]),
        }
        self
    }

    /// Keys and values.
    pub fn facts(&self) -> impl Iterator<Item = (&str, &str)> {
        self.0.iter().map(|[key, value]| (key.as_str(), value.as_str()))
    }
}

/// Licence of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct License {
    /// Name.
    pub name: String,
    /// Identifier of the SPDX list, or one that starts with `LicenseRef-`.
    pub spdx_id: String,
    /// What must be said with every copy; may be empty.
    pub notice: String,
}

impl License {
    /// Licence of scenes of the Waymo Open Dataset and of what is derived from them.
    pub fn waymo() -> Self {
        Self {
            name: "Waymo Dataset License Agreement for Non-Commercial Use".to_owned(),
            spdx_id: "LicenseRef-Waymo-Non-Commercial".to_owned(),
            notice: "This file was made using the Waymo Open Dataset, provided by Waymo LLC under license \
                     terms available at waymo.com/open. Non-commercial use only."
                .to_owned(),
        }
    }

    /// Licence of scenes of Argoverse 2 and of what is derived from them.
    pub fn argoverse2() -> Self {
        Self {
            name: "Creative Commons Attribution-NonCommercial-ShareAlike 4.0".to_owned(),
            spdx_id: "CC-BY-NC-SA-4.0".to_owned(),
            notice: "This file was made using Argoverse 2, provided under license terms available at \
                     argoverse.org. Non-commercial use only."
                .to_owned(),
        }
    }

    /// Licence of the scenes of a data set by the name in their metadata (`waymo`, `argoverse2`); `None` if it is unknown.
    pub fn of_dataset(dataset: &str) -> Option<Self> {
        match &dataset.to_ascii_lowercase()[..] {
            "waymo" => Some(Self::waymo()),
            "argoverse2" | "av2" => Some(Self::argoverse2()),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_keep_their_order_and_have_one_value() {
        let provenance = Provenance::default().with("b", "1").with("a", "2").with("b", "3");
        assert_eq!(provenance.facts().collect::<Vec<_>>(), [("b", "3"), ("a", "2")]);
    }

    #[test]
    fn a_data_set_has_its_own_licence() {
        assert!(License::of_dataset("waymo").unwrap().notice.contains("waymo.com/open"));
        assert_eq!(License::of_dataset("argoverse2").unwrap().spdx_id, "CC-BY-NC-SA-4.0");
        assert_eq!(License::of_dataset("sage"), None);
    }
}
