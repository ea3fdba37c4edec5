//! JSON objects with known keys, whose other keys are kept as text.
//!
//! They are written again as they were, and take no more memory than the file.

use std::{borrow::Cow, fmt, marker::PhantomData};

use serde::{
    Deserialize, Deserializer,
    de::{Error as _, MapAccess, Visitor},
};
use serde_json::value::RawValue;

/// Keys that are not known, with their values as JSON text.
pub(super) type Rest<'j> = Vec<(Cow<'j, str>, &'j RawValue)>;

/// What is read from a JSON object.
pub(super) trait Keyed<'j>: Default {
    /// What it is, for errors.
    const WHAT: &'static str;

    /// Takes the value of a key; false if the key is not known.
    fn take<A: MapAccess<'j>>(&mut self, key: &str, map: &mut A) -> Result<bool, A::Error>;

    /// A key that is missing.
    fn missing(&self) -> Option<&'static str>;

    /// Where the other keys go; `None` if they are not kept.
    fn rest(&mut self) -> Option<&mut Rest<'j>>;
}

/// Takes the value of a key that an object has once.
pub(super) fn once<'j, T: Deserialize<'j>, A: MapAccess<'j>>(
    slot: &mut Option<T>,
    map: &mut A,
) -> Result<bool, A::Error> {
    if slot.is_some() {
        return Err(A::Error::custom("the key occurs twice"));
    }
    *slot = Some(map.next_value()?);
    Ok(true)
}

/// Reads a [`Keyed`] by serde.
#[derive(Default)]
pub(super) struct Of<T>(pub(super) T);

impl<'j, T: Keyed<'j>> Deserialize<'j> for Of<T> {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(ObjectVisitor(PhantomData))
    }
}

struct ObjectVisitor<T>(PhantomData<T>);

impl<'j, T: Keyed<'j>> Visitor<'j> for ObjectVisitor<T> {
    type Value = Of<T>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(T::WHAT)
    }

    fn visit_map<A: MapAccess<'j>>(self, mut map: A) -> Result<Of<T>, A::Error> {
        let mut found = T::default();
        while let Some(Key(key)) = map.next_key()? {
            if found.take(&key, &mut map)? {
                continue;
            }
            let value: &RawValue = map.next_value()?;
            if let Some(rest) = found.rest() {
                rest.push((key, value));
            }
        }
        match found.missing() {
            Some(key) => Err(A::Error::missing_field(key)),
            None => Ok(Of(found)),
        }
    }
}

/// A key, not copied where it has no escapes.
pub(super) struct Key<'j>(pub(super) Cow<'j, str>);

impl<'j> Deserialize<'j> for Key<'j> {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        struct KeyVisitor;
        impl<'j> Visitor<'j> for KeyVisitor {
            type Value = Key<'j>;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a text")
            }

            fn visit_borrowed_str<E>(self, text: &'j str) -> Result<Key<'j>, E> {
                Ok(Key(Cow::Borrowed(text)))
            }

            fn visit_str<E>(self, text: &str) -> Result<Key<'j>, E> {
                Ok(Key(Cow::Owned(text.to_owned())))
            }
        }
        deserializer.deserialize_str(KeyVisitor)
    }
}
