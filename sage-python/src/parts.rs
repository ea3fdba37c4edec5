//! What users name: the registries of the library, and drivers.

use std::sync::{Arc, OnceLock};

use advsage::{Registries, driver_spec::DriverSpec, ego::Ego, references, weights::SHIPPED};
use pyo3::{
    prelude::*,
    types::{PyDict, PyString},
};
use sage_core::objective::PRESETS;
use sage_data::procedural::Kind;
use sage_run::Result;
use sage_sim::{policy::EgoPolicy, reference::Reference};

use crate::{
    errors::{detached, keep_raised},
    planner::{self, Planner},
    planner_drive::{PlannerPolicy, Way},
};

/// All parts of the library. They do not change, so all calls share them.
///
/// *Errors*: none; two parts of a kind have different names.
pub(crate) fn registries() -> Result<&'static Registries> {
    static ALL: OnceLock<Registries> = OnceLock::new();
    match ALL.get() {
        Some(all) => Ok(all),
        None => {
            let all = Registries::of_attacks()?;
            Ok(ALL.get_or_init(|| all))
        }
    }
}

/// Names that options accept: a dictionary of lists, by option. Options of a part are written `name{"option": value}`.
#[pyfunction]
pub(crate) fn names(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    fn of<T: ?Sized>(registry: &sage_core::registry::Registry<T>) -> Vec<&'static str> {
        registry.entries().iter().map(|entry| entry.name).collect()
    }
    let all = detached(py, registries)?;
    let dict = PyDict::new(py);
    // A path, a policy and a program need more than their name.
    let drivers: Vec<&str> =
        of(&all.policies).into_iter().filter(|name| !["path", "process"].contains(name)).collect();
    dict.set_item("ego", drivers)?;
    dict.set_item("method", of(&all.generators))?;
    dict.set_item("merger", of(&all.mergers))?;
    dict.set_item("selection", PRESETS.map(|(name, _)| name))?;
    dict.set_item("feasibility", of(&all.feasibilities))?;
    dict.set_item("weights", SHIPPED)?;
    dict.set_item("kind", Kind::ALL.map(Kind::name))?;
    dict.set_item("convention", ["paper", "release"])?;
    Ok(dict)
}

/// Who drives the ego.
#[derive(Clone)]
pub(crate) struct Driver {
    /// Its name and options.
    pub(crate) label: String,
    pub(crate) policy: Arc<dyn EgoPolicy>,
    /// Its planner, if it is one of Python, which is called on the caller's thread alone.
    pub(crate) planner: Option<Arc<Planner>>,
    /// The drivers that say whether its contacts are preventable.
    pub(crate) references: Arc<Vec<Reference>>,
}

/// Beginning of the name of a planner that is imported.
const IMPORTED: &str = "py:";

impl Driver {
    /// The driver that a user names.
    ///
    /// *Errors*: a name that nothing has, or options that the policy refuses.
    pub(crate) fn of(py: Python<'_>, ego: &Bound<'_, PyAny>) -> PyResult<Self> {
        // What a planner raised before is no cause of what this one does.
        keep_raised(None);
        if let Ok(name) = ego.cast::<PyString>() {
            let name = name.to_str()?.to_owned();
            return match name.strip_prefix(IMPORTED) {
                Some(class) => Self::of_object(&planner::imported(py, class)?),
                None => detached(py, || Self::named(&name)),
            };
        }
        Self::of_object(ego)
    }

    /// Raises what stopped its planner, if something did: an interrupt is no error of the driver.
    ///
    /// *Errors*: that, such as Ctrl-C.
    pub(crate) fn raise_interrupt(&self) -> PyResult<()> {
        self.planner.as_ref().map_or(Ok(()), |planner| planner.raise_interrupt())
    }

    /// The driver of an object with a method `act`.
    fn of_object(object: &Bound<'_, PyAny>) -> PyResult<Self> {
        let planner = Arc::new(Planner::new(object)?);
        let policy = Arc::new(PlannerPolicy::new(Way::Call(planner.clone())));
        let references = detached(object.py(), || {
            Ok(references::references(&references::default_names(), "", registries()?)?)
        })?;
        Ok(Self {
            label: planner.name.clone(),
            policy,
            planner: Some(planner),
            references: references.into(),
        })
    }

    /// The same, or the driver of a name.
    ///
    /// *Errors*: as [`Driver::of`].
    pub(crate) fn of_optional(py: Python<'_>, ego: Option<&Bound<'_, PyAny>>, name: &str) -> PyResult<Self> {
        ego.map_or_else(|| detached(py, || Self::named(name)), |ego| Self::of(py, ego))
    }

    /// Takes other reference drivers than the default ones.
    ///
    /// *Errors*: a name that nothing has, or one that is given twice.
    pub(crate) fn with_references(mut self, names: &[String]) -> Result<Self> {
        let tested =
            if self.planner.is_some() { "" } else { self.label.split('{').next().unwrap_or_default() };
        self.references = references::references(names, tested, registries()?)?.into();
        Ok(self)
    }

    fn named(name: &str) -> Result<Self> {
        let part: DriverSpec = name.parse().map_err(advsage::Error::Value)?;
        let Ego { label, policy, references, .. } = Ego::new(&part, registries()?)?;
        Ok(Self { label, policy: policy.into(), planner: None, references: references.into() })
    }
}
