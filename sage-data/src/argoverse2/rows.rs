//! The rows of a scenario: a road user in a step, read column by column.
//!
//! A library reads Parquet, behind a guard: it panics at some damaged files and believes the sizes of pages. So sizes are
//! checked before (`pages.rs`), and a panic is an error.

use std::collections::HashMap;

use bytes::Bytes;
use parquet::{
    basic::Compression,
    column::reader::{ColumnReader, ColumnReaderImpl},
    data_type::{ByteArray, DataType},
    file::{
        metadata::{ColumnChunkMetaData, ParquetMetaData},
        reader::{FileReader, RowGroupReader, SerializedFileReader},
    },
};
use sage_core::defect;

use super::pages::decompressed_size;

/// Most rows. Real files have 2 000 to 30 000.
const MOST_ROWS: usize = 200_000;
/// Most bytes of all columns together after decompression.
const MOST_BYTES: u64 = 48 << 20;
/// Rows that are read at once.
const BATCH: usize = 4096;
/// Longest text, bytes.
const LONGEST_TEXT: usize = 256;

/// Columns with a value in every row.
#[derive(Default)]
pub(super) struct Rows {
    /// Place of the row's id in `ids`.
    pub(super) track: Vec<u32>,
    pub(super) step: Vec<i64>,
    /// Position x and y, heading, velocity x and y.
    pub(super) motion: [Vec<f64>; 5],
    /// Id, type and category of each road user, as its first row says, in the order of the file.
    pub(super) users: Vec<User>,
    /// From the first row; empty if the file has no such column.
    pub(super) scenario_id: String,
    pub(super) focal_track_id: String,
    pub(super) city: String,
}

/// A road user.
pub(super) struct User {
    pub(super) id: String,
    pub(super) kind: String,
    /// 0 fragment, 1 unscored, 2 scored, 3 focal; without that column 1.
    pub(super) category: i64,
}

/// Names of the columns of [`Rows::motion`].
const MOTION: [&str; 5] = ["position_x", "position_y", "heading", "velocity_x", "velocity_y"];

/// Reads the rows of a file.
///
/// *Errors*: the column, and what is wrong with it.
pub(super) fn read(bytes: Vec<u8>) -> Result<Rows, Problem> {
    // The library panics at some damaged files.
    defect::expected(|| read_columns(bytes)).unwrap_or_else(|| Err(Problem::file("it is damaged".to_owned())))
}

fn read_columns(bytes: Vec<u8>) -> Result<Rows, Problem> {
    let file = Bytes::from(bytes);
    let reader = SerializedFileReader::new(file.clone()).map_err(|error| Problem::file(error.to_string()))?;
    let metadata = reader.metadata();
    check(&file, metadata)?;
    let mut rows = Rows::default();
    let (mut texts, mut users) = (Texts::default(), HashMap::new());
    for number in 0..metadata.num_row_groups() {
        let group = reader.get_row_group(number).map_err(|error| Problem::file(error.to_string()))?;
        let columns =
            Group { group: &*group, rows: usize::try_from(group.metadata().num_rows()).unwrap_or(0) };
        let tracks = columns.texts("track_id", &mut texts)?;
        let kinds = columns.texts("object_type", &mut texts)?;
        let categories = columns.optional("object_category", Group::integers)?;
        for (k, (id, kind)) in tracks.into_iter().zip(kinds).enumerate() {
            let number = *users.entry(id).or_insert_with(|| {
                let category = categories.as_ref().map_or(1, |all| all[k]);
                let [id, kind] = [id, kind].map(|text| texts.all[text as usize].clone());
                rows.users.push(User { id, kind, category });
                rows.users.len() as u32 - 1
            });
            rows.track.push(number);
        }
        rows.step.extend(columns.integers("timestep")?);
        for (name, column) in MOTION.iter().zip(&mut rows.motion) {
            column.extend(columns.numbers(name)?);
        }
        let names = [
            ("scenario_id", &mut rows.scenario_id),
            ("focal_track_id", &mut rows.focal_track_id),
            ("city", &mut rows.city),
        ];
        for (name, text) in names {
            if text.is_empty() {
                *text = columns.first_text(name)?;
            }
        }
    }
    if rows.track.is_empty() {
        return Err(Problem::file("it has no rows".to_owned()));
    }
    Ok(rows)
}

/// What is wrong, and in which column; none for the whole file.
#[derive(Debug)]
pub(super) struct Problem {
    pub(super) column: String,
    pub(super) found: String,
    pub(super) expected: String,
}

impl Problem {
    fn file(found: String) -> Self {
        Self {
            column: "(file)".to_owned(),
            found: format!("no scenario that can be read ({})", found.replace('\n', " ")),
            expected: "a Parquet file of Argoverse 2 motion forecasting".to_owned(),
        }
    }

    fn column(column: &str, found: impl Into<String>, expected: &str) -> Self {
        Self { column: column.to_owned(), found: found.into(), expected: expected.to_owned() }
    }
}

/// Refuses what would take much memory, and compressions that are not read.
fn check(file: &Bytes, metadata: &ParquetMetaData) -> Result<(), Problem> {
    let rows: i64 =
        metadata.row_groups().iter().map(|group| group.num_rows().max(0)).fold(0, i64::saturating_add);
    if rows > MOST_ROWS as i64 {
        return Err(Problem::column("(rows)", format!("{rows} rows"), "at most 200000, as a scenario has"));
    }
    let mut bytes = 0u64;
    for group in metadata.row_groups() {
        if group.num_rows() < 0 {
            return Err(Problem::column("(rows)", "a negative number of rows", "a whole file"));
        }
        for column in group.columns() {
            let name = column.column_path().string();
            let size = check_chunk(file, column, group.num_rows() as u64).map_err(|(found, expected)| {
                Problem { column: name.escape_debug().to_string(), found, expected: expected.to_owned() }
            })?;
            bytes += size;
        }
    }
    if bytes > MOST_BYTES {
        return Err(Problem::column(
            "",
            format!("{bytes} bytes of columns"),
            "at most 50331648, as a scenario has",
        ));
    }
    Ok(())
}

/// Decompressed size of a column chunk with a number of rows.
///
/// *Errors*: what was found, and what is expected.
fn check_chunk(file: &Bytes, column: &ColumnChunkMetaData, rows: u64) -> Result<u64, (String, &'static str)> {
    if !matches!(column.compression(), Compression::UNCOMPRESSED | Compression::SNAPPY) {
        // Without the level: GZIP(GzipLevel(6)).
        let name = column.compression().to_string();
        let found = format!("compressed by {}", name.split('(').next().unwrap_or_default());
        return Err((found, "snappy or no compression; save the file again"));
    }
    // The reader begins at the dictionary, wherever it is.
    let first = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
    if first > column.data_page_offset() {
        return Err(("with a dictionary behind its values".to_owned(), "a whole file"));
    }
    let range = usize::try_from(first).ok().zip(usize::try_from(column.compressed_size()).ok());
    let chunk = range.and_then(|(first, size)| file.get(first..first.checked_add(size)?));
    let chunk = chunk.ok_or_else(|| ("outside of the file".to_owned(), "a whole file"))?;
    decompressed_size(chunk, rows).map_err(|problem| (problem, "a whole file"))
}

/// Texts of a file, each once.
#[derive(Default)]
struct Texts {
    all: Vec<String>,
    numbers: HashMap<String, u32>,
}

impl Texts {
    /// Number of a text; `None` for one that is long or not UTF-8.
    fn number(&mut self, text: &[u8]) -> Option<u32> {
        let text = std::str::from_utf8(text).ok().filter(|text| text.len() <= LONGEST_TEXT)?;
        if let Some(number) = self.numbers.get(text) {
            return Some(*number);
        }
        let number = self.all.len() as u32;
        self.all.push(text.to_owned());
        self.numbers.insert(text.to_owned(), number);
        Some(number)
    }
}

/// The columns of a row group.
struct Group<'g> {
    group: &'g dyn RowGroupReader,
    rows: usize,
}

impl Group<'_> {
    /// Number of a column.
    fn find(&self, name: &str) -> Option<usize> {
        self.group.metadata().columns().iter().position(|column| column.column_path().string() == name)
    }

    fn optional<T>(
        &self,
        name: &str,
        read: impl FnOnce(&Self, &str) -> Result<T, Problem>,
    ) -> Result<Option<T>, Problem> {
        self.find(name).map(|_| read(self, name)).transpose()
    }

    fn reader(&self, name: &str) -> Result<ColumnReader, Problem> {
        let number =
            self.find(name).ok_or_else(|| Problem::column(name, "missing", "a column of the scenario"))?;
        self.group
            .get_column_reader(number)
            .map_err(|error| Problem::column(name, format!("unreadable ({error})"), "a whole file"))
    }

    /// The texts of a column by their number among all texts: most rows have one that another has.
    fn texts(&self, name: &str, texts: &mut Texts) -> Result<Vec<u32>, Problem> {
        match self.reader(name)? {
            ColumnReader::ByteArrayColumnReader(column) => {
                self.values(name, column, |text: ByteArray| texts.number(text.data()))
            }
            other => Err(wrong_type(name, &other, "texts")),
        }
    }

    /// The first text of a column; empty if there is none, as pandas writes a column of nothing.
    fn first_text(&self, name: &str) -> Result<String, Problem> {
        if self.find(name).is_none() {
            return Ok(String::new());
        }
        let ColumnReader::ByteArrayColumnReader(mut column) = self.reader(name)? else {
            return Ok(String::new());
        };
        let (mut levels, mut values) = (Vec::new(), Vec::new());
        column
            .read_records(1, Some(&mut levels), None, &mut values)
            .map_err(|error| Problem::column(name, format!("unreadable ({error})"), "a whole file"))?;
        let text = values.first().map(|text: &ByteArray| text.data()).unwrap_or_default();
        let text = std::str::from_utf8(text).ok().filter(|text| text.len() <= LONGEST_TEXT);
        text.map(str::to_owned)
            .ok_or_else(|| Problem::column(name, "a long text, or one that is not UTF-8", "a name"))
    }

    fn integers(&self, name: &str) -> Result<Vec<i64>, Problem> {
        match self.reader(name)? {
            ColumnReader::Int64ColumnReader(column) => self.values(name, column, Some),
            ColumnReader::Int32ColumnReader(column) => self.values(name, column, |x| Some(i64::from(x))),
            // What pandas makes of integers with gaps.
            ColumnReader::DoubleColumnReader(column) => {
                self.values(name, column, |x| (x.fract() == 0.0 && x.abs() < 1e15).then_some(x as i64))
            }
            other => Err(wrong_type(name, &other, "integers")),
        }
    }

    fn numbers(&self, name: &str) -> Result<Vec<f64>, Problem> {
        match self.reader(name)? {
            ColumnReader::DoubleColumnReader(column) => self.values(name, column, Some),
            ColumnReader::FloatColumnReader(column) => self.values(name, column, |x| Some(f64::from(x))),
            other => Err(wrong_type(name, &other, "numbers")),
        }
    }

    /// The values of a column, one for each row.
    fn values<T: DataType, V>(
        &self,
        name: &str,
        mut column: ColumnReaderImpl<T>,
        mut convert: impl FnMut(T::T) -> Option<V>,
    ) -> Result<Vec<V>, Problem> {
        let mut all = Vec::new();
        let (mut batch, mut levels) = (Vec::new(), Vec::new());
        loop {
            batch.clear();
            levels.clear();
            let read = column.read_records(BATCH, Some(&mut levels), None, &mut batch);
            let (records, values, _) =
                read.map_err(|error| Problem::column(name, format!("unreadable ({error})"), "a whole file"))?;
            if records != values {
                return Err(Problem::column(
                    name,
                    format!("empty in {} rows", records - values.min(records)),
                    "a value in every row",
                ));
            }
            if records == 0 {
                break;
            }
            for value in batch.drain(..) {
                let value = convert(value);
                all.push(value.ok_or_else(|| {
                    Problem::column(name, "a value that is long, not UTF-8, or no integer", "its values")
                })?);
            }
            if all.len() > self.rows {
                break;
            }
        }
        if all.len() != self.rows {
            let found = format!("{} values in a group of {} rows", all.len(), self.rows);
            return Err(Problem::column(name, found, "a value in every row"));
        }
        Ok(all)
    }
}

fn wrong_type(name: &str, found: &ColumnReader, expected: &str) -> Problem {
    let found = match found {
        ColumnReader::BoolColumnReader(_) => "bools",
        ColumnReader::Int32ColumnReader(_) | ColumnReader::Int64ColumnReader(_) => "integers",
        ColumnReader::Int96ColumnReader(_) => "times",
        ColumnReader::FloatColumnReader(_) | ColumnReader::DoubleColumnReader(_) => "numbers",
        ColumnReader::ByteArrayColumnReader(_) => "texts",
        ColumnReader::FixedLenByteArrayColumnReader(_) => "bytes",
    };
    Problem::column(name, format!("a column of {found}"), expected)
}
