//! Typed access to the values of a document, with errors that name file, field and value.

use std::{cell::Cell, fmt, path::Path};

use sage_core::motion::MAX_COORDINATE;

use crate::{
    Error, float_rows,
    pickle::{Array, Document, Dtype, ElementKind, Id, Node},
};

/// A field of the file: its keys from the root. Keys are borrowed from the stack and copied only for an
/// error.
#[derive(Clone, Copy)]
pub(super) struct Field<'f> {
    parent: Option<&'f Self>,
    key: &'f str,
}

impl<'f> Field<'f> {
    pub(super) const ROOT: Field<'static> = Field { parent: None, key: "" };

    pub(super) fn key(&'f self, key: &'f str) -> Self {
        Self { parent: Some(self), key }
    }
}

impl fmt::Display for Field<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.parent {
            None => f.write_str(self.key),
            Some(parent) if parent.parent.is_none() => f.write_str(self.key),
            Some(parent) => write!(f, "{parent}/{}", self.key),
        }
    }
}

const F32: Dtype = Dtype { kind: ElementKind::Float, size: 4, big_endian: false };
const F64: Dtype = Dtype { kind: ElementKind::Float, size: 8, big_endian: false };

/// Memory of a track, feature or light besides its name and numbers, bytes.
const OVERHEAD: usize = 384;

/// Access to a document that is being read as a scene.
pub(super) struct Fields<'d> {
    pub(super) document: &'d Document,
    path: &'d Path,
    /// Bytes that may still be copied out of the document.
    budget: Cell<usize>,
    /// Number of entries and bytes of text that may still be read.
    work: Cell<usize>,
    is_over_budget: Cell<bool>,
}

impl<'d> Fields<'d> {
    pub(super) fn new(document: &'d Document, path: &'d Path) -> Self {
        // Values can be shared, so a short file could cause unlimited copies and searches. For a regular
        // file, floats take twice their bytes, and each dict is read about ten times. Small files share
        // columns.
        let size = document.file_size();
        let budget = size.saturating_mul(4).saturating_add(4 << 20);
        let work = size.saturating_mul(16).saturating_add(4 << 20);
        Self {
            document,
            path,
            budget: Cell::new(budget),
            work: Cell::new(work),
            is_over_budget: Cell::new(false),
        }
    }

    /// Error that states a value of the document.
    pub(super) fn wrong(&self, field: &Field, id: Id, expected: impl Into<String>) -> Error {
        self.error(field, self.document.describe(id), expected)
    }

    /// Error that states a description of a value.
    pub(super) fn error(
        &self,
        field: &Field,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Error {
        Error::Field {
            path: self.path.to_owned(),
            field: field.to_string(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    /// Accounts for copying `bytes` bytes.
    pub(super) fn spend(&self, field: &Field, bytes: usize) -> Result<(), Error> {
        match self.budget.get().checked_sub(bytes) {
            Some(left) => self.budget.set(left),
            None => {
                self.is_over_budget.set(true);
                return Err(self.used_up(field));
            }
        }
        if self.work.get() == 0 { Err(self.used_up(field)) } else { Ok(()) }
    }

    /// Accounts for reading `n` entries or bytes of text; `false` if the limit is reached.
    pub(super) fn spend_work(&self, n: usize) -> bool {
        self.work.set(self.work.get().saturating_sub(n));
        self.work.get() > 0
    }

    /// Whether the limit of work is reached: then nothing more can be read.
    pub(super) fn is_used_up(&self) -> bool {
        self.work.get() == 0 || self.is_over_budget.get()
    }

    fn used_up(&self, field: &Field) -> Error {
        self.error(
            field,
            "a value that the file repeats too often",
            "a scene that is not many times larger than its file",
        )
    }

    /// Value of a key. The search counts as work.
    fn get(&self, dict: Id, key: &str) -> Option<Id> {
        let entries = self.document.entries(dict)?;
        self.spend_work(entries.len()).then(|| self.document.get(dict, key)).flatten()
    }

    pub(super) fn optional(&self, dict: Id, key: &str) -> Option<Id> {
        let id = self.get(dict, key)?;
        (!matches!(self.document.node(id), Node::None)).then_some(id)
    }

    pub(super) fn required(&self, dict: Id, field: &Field, key: &str, expected: &str) -> Result<Id, Error> {
        self.get(dict, key).ok_or_else(|| match self.work.get() {
            0 => self.used_up(field),
            _ => self.error(&field.key(key), "missing", expected),
        })
    }

    pub(super) fn entries(&self, id: Id, field: &Field) -> Result<&'d [(Id, Id)], Error> {
        self.document.entries(id).ok_or_else(|| self.wrong(field, id, "a dict"))
    }

    pub(super) fn text(&self, id: Id, field: &Field) -> Result<&'d str, Error> {
        let length = self.document.text_length(id).ok_or_else(|| self.wrong(field, id, "a str"))?;
        if !self.spend_work(length) {
            return Err(self.used_up(field));
        }
        self.document.text(id).ok_or_else(|| self.wrong(field, id, "a str"))
    }

    /// A text that is copied into the scene.
    pub(super) fn word(&self, id: Id, field: &Field) -> Result<&'d str, Error> {
        let text = self.text(id, field)?;
        self.spend(field, text.len())?;
        Ok(text)
    }

    /// A key of a dict of tracks or features.
    pub(super) fn identifier(&self, id: Id, field: &Field) -> Result<String, Error> {
        let name = self.document.identifier(id);
        let name = name.ok_or_else(|| self.wrong(field, id, "an id, a str or an int"))?;
        self.spend(field, name.len() + OVERHEAD)?;
        Ok(name)
    }

    /// One finite number per frame, from an array of shape (n,) or (n, 1), or from a list.
    pub(super) fn column(&self, id: Id, field: &Field, length: usize) -> Result<Vec<f64>, Error> {
        self.column_within(MAX_COORDINATE, id, field, length)
    }

    /// As [`Fields::column`], for numbers of any size up to `limit`.
    pub(super) fn column_within(
        &self,
        limit: f64,
        id: Id,
        field: &Field,
        length: usize,
    ) -> Result<Vec<f64>, Error> {
        let mut rows = Vec::new();
        self.append_rows_within::<1>(limit, &mut rows, id, field, &[1])?;
        self.check_length(field, rows.len(), length)?;
        Ok(rows.into_iter().map(|[x]| x).collect())
    }

    /// One number per frame, finite where the frame is valid; elsewhere one that is not finite becomes 0.
    pub(super) fn valid_column(&self, id: Id, field: &Field, valid: &[bool]) -> Result<Vec<f64>, Error> {
        Ok(self.valid_table::<1>(id, field, &[1], valid)?.into_iter().map(|[x]| x).collect())
    }

    /// `N` numbers per frame, finite where the frame is valid; elsewhere a row that is not finite becomes 0. Of wider rows
    /// the first `N`.
    pub(super) fn valid_table<const N: usize>(
        &self,
        id: Id,
        field: &Field,
        widths: &[usize],
        valid: &[bool],
    ) -> Result<Vec<[f64; N]>, Error> {
        let mut rows = Vec::new();
        self.append_unchecked(&mut rows, id, field, widths)?;
        self.check_length(field, rows.len(), valid.len())?;
        if !all_within(MAX_COORDINATE, &rows) {
            for (row, _) in rows.iter_mut().zip(valid).filter(|(_, valid)| !**valid) {
                if !all_within(MAX_COORDINATE, std::slice::from_ref(row)) {
                    *row = [0.0; N];
                }
            }
            self.check_within(MAX_COORDINATE, &rows, field)?;
        }
        Ok(rows)
    }

    /// Checks numbers that stand for all frames.
    pub(super) fn check_number(&self, field: &Field, numbers: &[f64]) -> Result<(), Error> {
        match numbers.iter().find(|x| !(x.abs() <= MAX_COORDINATE)) {
            Some(x) => Err(self.not_within(MAX_COORDINATE, field, *x)),
            None => Ok(()),
        }
    }

    pub(super) fn check_length(&self, field: &Field, found: usize, expected: usize) -> Result<(), Error> {
        if found == expected {
            return Ok(());
        }
        Err(self.error(field, format!("{found} rows"), format!("{expected} rows, one per frame")))
    }

    /// Rows of finite numbers within ±[`MAX_COORDINATE`], of any accepted width; missing columns are 0.
    pub(super) fn rows<const N: usize>(
        &self,
        id: Id,
        field: &Field,
        widths: &[usize],
    ) -> Result<Vec<[f64; N]>, Error> {
        let mut out = Vec::new();
        self.append_rows(&mut out, id, field, widths)?;
        Ok(out)
    }

    /// As [`Fields::rows`], with any numbers.
    pub(super) fn unchecked_rows<const N: usize>(
        &self,
        id: Id,
        field: &Field,
        widths: &[usize],
    ) -> Result<Vec<[f64; N]>, Error> {
        let mut out = Vec::new();
        self.append_unchecked(&mut out, id, field, widths)?;
        Ok(out)
    }

    /// As [`Fields::rows`], appended to `out`.
    pub(super) fn append_rows<const N: usize>(
        &self,
        out: &mut Vec<[f64; N]>,
        id: Id,
        field: &Field,
        widths: &[usize],
    ) -> Result<(), Error> {
        self.append_rows_within(MAX_COORDINATE, out, id, field, widths)
    }

    fn append_rows_within<const N: usize>(
        &self,
        limit: f64,
        out: &mut Vec<[f64; N]>,
        id: Id,
        field: &Field,
        widths: &[usize],
    ) -> Result<(), Error> {
        let first = out.len();
        self.append_unchecked(out, id, field, widths)?;
        self.check_within(limit, &out[first..], field)
    }

    /// Checks that all numbers of rows are finite and within ±`limit`.
    fn check_within<const N: usize>(
        &self,
        limit: f64,
        rows: &[[f64; N]],
        field: &Field,
    ) -> Result<(), Error> {
        // Only if the fast check of all numbers fails, the invalid number is searched.
        if all_within(limit, rows) {
            return Ok(());
        }
        let is_bad = |x: &f64| !(x.abs() <= limit);
        let invalid = rows.iter().enumerate().find_map(|(k, row)| Some((k, row.iter().find(|x| is_bad(x))?)));
        let (row, value) = invalid.unwrap_or((0, &f64::NAN));
        Err(self.not_within(limit, &field.key(&row.to_string()), *value))
    }

    fn not_within(&self, limit: f64, field: &Field, value: f64) -> Error {
        self.error(field, value.to_string(), format!("a finite number within ±{limit:e}"))
    }

    fn append_unchecked<const N: usize>(
        &self,
        out: &mut Vec<[f64; N]>,
        id: Id,
        field: &Field,
        widths: &[usize],
    ) -> Result<(), Error> {
        match self.document.node(id) {
            Node::Array(array) => self.append_array(out, array, id, field, widths)?,
            Node::List(items) | Node::Tuple(items) => {
                self.spend(field, size_of::<[f64; N]>() * items.len())?;
                for (k, item) in items.iter().enumerate() {
                    out.push(self.row(*item, &field.key(&k.to_string()), widths)?);
                }
            }
            _ => return Err(self.wrong(field, id, "an array or a list of numbers")),
        }
        Ok(())
    }

    /// Length of a row of a table, from its shape or its first row.
    pub(super) fn row_width(&self, id: Id) -> Option<usize> {
        match self.document.node(id) {
            Node::Array(array) => array.shape.get(1).map(|n| *n as usize),
            Node::List(rows) | Node::Tuple(rows) => match self.document.node(*rows.first()?) {
                Node::List(row) | Node::Tuple(row) => Some(row.len()),
                Node::Array(array) => array.shape.first().map(|n| *n as usize),
                _ => None,
            },
            _ => None,
        }
    }

    /// One row of a list of rows: a list, a small array, or a single number.
    fn row<const N: usize>(&self, id: Id, field: &Field, widths: &[usize]) -> Result<[f64; N], Error> {
        let expected = || format!("a row of {} numbers", widths_in_words(widths));
        let mut row = [0.0; N];
        match self.document.node(id) {
            Node::List(items) | Node::Tuple(items) => {
                if !widths.contains(&items.len()) {
                    return Err(self.wrong(field, id, expected()));
                }
                for (slot, item) in row.iter_mut().zip(items) {
                    *slot =
                        self.document.number(*item).ok_or_else(|| self.wrong(field, *item, "a number"))?;
                }
            }
            Node::Array(array) if array.shape.len() == 1 => {
                if !widths.contains(&(array.shape[0] as usize)) {
                    return Err(self.wrong(field, id, expected()));
                }
                for (slot, x) in row.iter_mut().zip(array.dtype.read(self.document.bytes(array.data))) {
                    *slot = x;
                }
            }
            _ if N == 1 => {
                row[0] = self.document.number(id).ok_or_else(|| self.wrong(field, id, "a number"))?;
            }
            _ => return Err(self.wrong(field, id, expected())),
        }
        Ok(row)
    }

    fn append_array<const N: usize>(
        &self,
        out: &mut Vec<[f64; N]>,
        array: &Array,
        id: Id,
        field: &Field,
        widths: &[usize],
    ) -> Result<(), Error> {
        let (rows, width) = match array.shape[..] {
            [rows, width] => (rows as usize, width as usize),
            [rows] => (rows as usize, 1),
            _ => (0, 0),
        };
        if !widths.contains(&width) {
            let expected = format!("an array of shape (n, {})", widths_in_words(widths));
            return Err(self.wrong(field, id, expected));
        }
        self.spend(field, size_of::<[f64; N]>() * rows)?;
        out.reserve(rows);
        let bytes = self.document.bytes(array.data);
        // Scene files contain little-endian floats in C order; the first two arms are fast paths for them.
        match (array.dtype, array.fortran && width > 1) {
            (F32, false) if width == N => out.extend(float_rows::of_f32(bytes)),
            (F64, false) if width == N => out.extend(float_rows::of_f64(bytes)),
            (dtype, fortran) => {
                let values: Vec<f64> = dtype.read(bytes).collect();
                let at = |row: usize, column: usize| {
                    if fortran { values[column * rows + row] } else { values[row * width + column] }
                };
                out.extend(
                    (0..rows).map(|row| std::array::from_fn(|c| if c < width { at(row, c) } else { 0.0 })),
                );
            }
        }
        Ok(())
    }
}

/// Whether all numbers are finite and within ±`limit`, in one branch-free pass. NaN also fails the comparison.
fn all_within<const N: usize>(limit: f64, rows: &[[f64; N]]) -> bool {
    !rows.as_flattened().iter().fold(false, |bad, x| bad | !(x.abs() <= limit))
}

fn widths_in_words(widths: &[usize]) -> String {
    widths.iter().map(usize::to_string).collect::<Vec<_>>().join(" or ")
}
