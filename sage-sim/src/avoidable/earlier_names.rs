//! Fields of rows that had other names before version 0.2. They are written under both names, and read under either; the
//! earlier ones go in the next version. Use as `#[serde(flatten, with = …)]`.

macro_rules! also_named {
    ($field:ident, $earlier:ident) => {
        #[doc = concat!("`", stringify!($field), "`, also as `", stringify!($earlier), "`.")]
        pub mod $field {
            use serde::{Deserialize, Deserializer, Serialize, Serializer};

            #[derive(Default, Serialize, Deserialize)]
            #[serde(default)]
            struct BothNames {
                $field: Option<f64>,
                $earlier: Option<f64>,
            }

            /// Writes both.
            pub fn serialize<S: Serializer>(value: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
                BothNames { $field: *value, $earlier: *value }.serialize(serializer)
            }

            /// Reads either.
            pub fn deserialize<'d, D: Deserializer<'d>>(deserializer: D) -> Result<Option<f64>, D::Error> {
                let BothNames { $field, $earlier } = BothNames::deserialize(deserializer)?;
                Ok($field.or($earlier))
            }
        }
    };
}

also_named!(latest_start, time_to_react);
also_named!(latest_brake, time_to_brake);
also_named!(latest_steer, time_to_steer);
