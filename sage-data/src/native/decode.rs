//! Decodes tensors into a scene and checks all guarantees of a scene.

use std::{collections::HashSet, ops::Range, path::Path, sync::Arc};

use safetensors::{Dtype, SafeTensors, tensor::Metadata};
use sage_core::{
    motion::{HISTORY, MAX_COORDINATE, NOW, check_path},
    scene::Note,
    scene::{
        AdversaryOrigin, Boundary, Lane, LightState, Map, MapFeature, MapKind, Neighbor, Scene, Track,
        TrackKind, TrafficLight,
    },
};

use super::{Header, KEY, Link, VERSION};
use crate::{
    Error, ReadOptions, float_rows,
    repairs::{self, Draft},
};

/// Tensors of a file, by name.
pub(super) struct Tensors<'b> {
    path: &'b Path,
    data: &'b [u8],
    metadata: Metadata,
}

/// One tensor.
#[derive(Clone, Copy)]
pub(super) struct Tensor<'t> {
    pub(super) dtype: Dtype,
    pub(super) shape: &'t [usize],
    pub(super) data: &'t [u8],
}

impl<'b> Tensors<'b> {
    pub(super) fn open(path: &'b Path, bytes: &'b [u8]) -> Result<Self, Error> {
        let (length, metadata) = SafeTensors::read_metadata(bytes).map_err(|problem| Error::Field {
            path: path.to_owned(),
            field: "(header)".to_owned(),
            found: problem.to_string(),
            expected: "a safetensors file".to_owned(),
        })?;
        let data = bytes.get(8 + length..).unwrap_or_default();
        Ok(Self { path, data, metadata })
    }

    pub(super) fn error(&self, field: &str, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::Field {
            path: self.path.to_owned(),
            field: field.to_owned(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub(super) fn find(&self, name: &str) -> Option<Tensor<'_>> {
        let info = self.metadata.info(name)?;
        let data = self.data.get(info.data_offsets.0..info.data_offsets.1)?;
        Some(Tensor { dtype: info.dtype, shape: &info.shape, data })
    }

    fn required(&self, name: &str) -> Result<Tensor<'_>, Error> {
        self.find(name).ok_or_else(|| self.error(name, "missing", "a tensor"))
    }

    fn header(&self) -> Result<Header, Error> {
        let text = self.metadata.metadata().as_ref().and_then(|m| m.get(KEY));
        let text = text.ok_or_else(|| self.error(KEY, "missing", "the header of a native scene"))?;
        let header: Header = serde_json::from_str(text)
            .map_err(|e| self.error(KEY, e.to_string(), "the header of a native scene"))?;
        if header.version != VERSION {
            return Err(self.error("version", header.version.to_string(), VERSION.to_string()));
        }
        Ok(header)
    }

    /// Rows of `N` finite numbers from a tensor of this shape.
    fn rows<const N: usize>(&self, name: &str, shape: &[usize], limit: f64) -> Result<Vec<[f64; N]>, Error> {
        self.columns::<N>(name, shape, limit)?.read(0..shape.iter().product::<usize>() / N)
    }

    /// A tensor of this shape whose rows are read on demand.
    fn columns<'n, const N: usize>(
        &'n self,
        name: &'n str,
        shape: &[usize],
        limit: f64,
    ) -> Result<Columns<'n, N>, Error> {
        let tensor = self.required(name)?;
        if tensor.shape != shape {
            return Err(self.error(name, format!("of shape {:?}", tensor.shape), format!("shape {shape:?}")));
        }
        match tensor.dtype {
            Dtype::F32 | Dtype::F64 => Ok(Columns { file: self, name, tensor, limit }),
            other => Err(self.error(name, format!("of type {other:?}"), "type F32 or F64")),
        }
    }

    /// Bytes of a tensor of this type and shape.
    fn bytes(&self, name: &str, dtype: Dtype, shape: &[usize]) -> Result<&[u8], Error> {
        let tensor = self.required(name)?;
        if tensor.dtype != dtype || tensor.shape != shape {
            let found = format!("of type {:?} and shape {:?}", tensor.dtype, tensor.shape);
            return Err(self.error(name, found, format!("type {dtype:?} and shape {shape:?}")));
        }
        Ok(tensor.data)
    }

    /// Rows of `N` integers.
    pub(super) fn integers<const N: usize>(&self, name: &str) -> Result<Vec<[i64; N]>, Error> {
        let tensor = self.required(name)?;
        match (tensor.dtype, tensor.shape) {
            (Dtype::I64, [_, width]) if *width == N => {
                let row = |raw: &[u8]| std::array::from_fn(|k| i64::from_le_bytes(raw.as_chunks::<8>().0[k]));
                Ok(tensor.data.chunks_exact(8 * N).map(row).collect())
            }
            (dtype, shape) => {
                let found = format!("of type {dtype:?} and shape {shape:?}");
                Err(self.error(name, found, format!("type I64 and shape [n, {N}]")))
            }
        }
    }
}

/// A tensor of floats as rows of `N`.
struct Columns<'n, const N: usize> {
    file: &'n Tensors<'n>,
    name: &'n str,
    tensor: Tensor<'n>,
    /// Largest magnitude of a number.
    limit: f64,
}

impl<const N: usize> Columns<'_, N> {
    /// Reads a range of rows.
    fn read(&self, rows: Range<usize>) -> Result<Vec<[f64; N]>, Error> {
        let bytes = |size: usize| &self.tensor.data[rows.start * N * size..rows.end * N * size];
        let read: Vec<[f64; N]> = match self.tensor.dtype {
            Dtype::F32 => float_rows::of_f32(bytes(4)).collect(),
            _ => float_rows::of_f64(bytes(8)).collect(),
        };
        // NaN also fails the comparison.
        let is_bad = |x: &f64| !(x.abs() <= self.limit);
        if read.as_flattened().iter().fold(false, |bad, x| bad | is_bad(x)) {
            let culprit =
                read.iter().enumerate().find_map(|(k, row)| Some((k, row.iter().find(|x| is_bad(x))?)));
            let (row, value) = culprit.unwrap_or((0, &f64::NAN));
            let field = format!("{}/{}", self.name, rows.start + row);
            let expected = format!("a finite number within ±{:e}", self.limit);
            return Err(self.file.error(&field, value.to_string(), expected));
        }
        Ok(read)
    }
}

/// Turns the bytes of a native file into a checked scene; `path` names it in errors.
///
/// *Errors*: [`Error::Field`] with the tensor or key, the value found and the value expected.
pub(crate) fn decode(bytes: &[u8], options: &ReadOptions, path: &Path) -> Result<Scene, Error> {
    let file = Tensors::open(path, bytes)?;
    let header = file.header()?;
    if header.frames < HISTORY {
        return Err(file.error("frames", header.frames.to_string(), format!("at least {HISTORY}")));
    }
    let tracks = tracks(&file, &header)?;
    match tracks.get(header.ego) {
        Some(ego) if ego.is_valid(NOW) => {}
        _ => return Err(file.error("ego", header.ego.to_string(), "a track that is valid now")),
    }
    if let Some(adversary) = header.adversary {
        let has_valid_frame = tracks.get(adversary).is_some_and(|track| track.valid[..=NOW].contains(&true));
        if !has_valid_frame || adversary == header.ego {
            return Err(file.error(
                "adversary",
                adversary.to_string(),
                "a track other than the ego with a valid frame in history",
            ));
        }
    }
    let count = file.required("timestamps")?.shape.iter().product::<usize>();
    if count != 0 && count != header.frames {
        return Err(file.error("timestamps", format!("{count} values"), "one a frame, or none"));
    }
    let timestamps = file.rows::<1>("timestamps", &[count], f64::MAX)?.into_iter().map(|[t]| t).collect();
    let map = Arc::new(map(&file, &header)?);
    let lights = lights(&file, &header)?;
    let scene = Scene {
        id: header.id,
        frames: header.frames,
        timestamps,
        tracks: tracks.into(),
        map,
        lights,
        ego: header.ego,
        adversary: header.adversary,
        adversary_origin: header.adversary_origin,
        notes: header.notes.into_iter().map(Note::of_text).collect(),
        held: Vec::new(),
    };
    finished(scene, options, path)
}

/// A native scene with the options of reading.
fn finished(scene: Scene, options: &ReadOptions, path: &Path) -> Result<Scene, Error> {
    let (adversary, origin, count) = (scene.adversary, scene.adversary_origin, scene.tracks.len());
    // The header names whoever the adversary was, a person too.
    let is_named = matches!(origin, AdversaryOrigin::File | AdversaryOrigin::User);
    let named = adversary.filter(|_| is_named);
    let added = named.iter().map(|track| scene.tracks[*track].id.clone()).collect();
    let draft = Draft { scene, named, added, sample_rate: None, now_index: None };
    let mut decoded = repairs::finish(draft, options, path)?;
    if decoded.frames.is_none() && decoded.scene.tracks.len() == count {
        (decoded.scene.adversary, decoded.scene.adversary_origin) = (adversary, origin);
    }
    Ok(decoded.scene)
}

fn tracks(file: &Tensors, header: &Header) -> Result<Vec<Track>, Error> {
    let (n, frames) = (header.tracks.len(), header.frames);
    let position = file.columns::<3>("tracks.position", &[n, frames, 3], MAX_COORDINATE)?;
    let velocity = file.columns::<2>("tracks.velocity", &[n, frames, 2], MAX_COORDINATE)?;
    let column = |name| file.columns::<1>(name, &[n, frames], MAX_COORDINATE);
    let (heading, length) = (column("tracks.heading")?, column("tracks.length")?);
    let (width, height) = (column("tracks.width")?, column("tracks.height")?);
    let valid = file.bytes("tracks.valid", Dtype::BOOL, &[n, frames])?;
    let mut known_ids = HashSet::with_capacity(n);
    let mut tracks = Vec::with_capacity(n);
    for (k, (id, kind)) in header.tracks.iter().enumerate() {
        if !known_ids.insert(id) {
            return Err(file.error("tracks", format!("`{id}` twice"), "one track an id"));
        }
        let of = k * frames..(k + 1) * frames;
        let [length, width, height] =
            [length.read(of.clone())?, width.read(of.clone())?, height.read(of.clone())?];
        let track = Track {
            id: id.clone(),
            kind: TrackKind::from_name(kind),
            position: position.read(of.clone())?,
            heading: heading.read(of.clone())?.into_flattened(),
            velocity: velocity.read(of.clone())?,
            size: (length.iter().zip(width).zip(height)).map(|((l, w), h)| [l[0], w[0], h[0]]).collect(),
            valid: valid[of].iter().map(|v| *v != 0).collect(),
        };
        let bad =
            (0..frames).find(|&f| track.valid[f] && !(track.size[f][0] > 0.0 && track.size[f][1] > 0.0));
        if let Some(frame) = bad {
            let [length, width, _] = track.size[frame];
            let found = format!("{length} × {width} at frame {frame} of track `{id}`");
            return Err(file.error("tracks.length", found, "sizes above 0 where the track is valid"));
        }
        let positions = (0..frames).filter(|f| track.valid[*f]).map(|f| (f, track.point(f)));
        check_path(positions).map_err(|problem| {
            let found = format!("{} at frame {} of track `{id}`", problem.found(), problem.frame());
            file.error("tracks.position", found, problem.expected())
        })?;
        tracks.push(track);
    }
    Ok(tracks)
}

fn map(file: &Tensors, header: &Header) -> Result<Map, Error> {
    let mut total = 0usize;
    let mut known_ids = HashSet::with_capacity(header.features.len());
    let mut features = Vec::with_capacity(header.features.len());
    for (id, kind, points) in &header.features {
        if !known_ids.insert(id) {
            return Err(file.error("features", format!("`{id}` twice"), "one feature an id"));
        }
        let end = total.checked_add(*points).filter(|_| *points > 0);
        let end = end
            .ok_or_else(|| file.error("features", format!("`{id}` with {points} points"), "at least one"))?;
        features.push(MapFeature {
            id: id.clone(),
            kind: MapKind::from_name(kind),
            points: total..end,
            lane: None,
        });
        total = end;
    }
    // The shape check bounds the sum of the counts by the size of the file.
    let points = file.rows::<3>("map.points", &[total, 3], MAX_COORDINATE)?;
    let widths = file.required("lane.width")?.shape.first().copied().unwrap_or(0);
    let widths = file.rows::<2>("lane.width", &[widths, 2], MAX_COORDINATE)?;
    let mut left = &widths[..];
    for (feature, speed_limit, count) in &header.lanes {
        let width = left.split_at_checked(*count);
        let (width, rest) = width.ok_or_else(|| {
            file.error("lanes", format!("{count} widths"), "as many as `lane.width` has rows")
        })?;
        left = rest;
        if speed_limit.is_some_and(|limit| !(limit.is_finite() && limit > 0.0)) {
            return Err(file.error("lanes", format!("speed limit {speed_limit:?}"), "m/s above 0, or null"));
        }
        let lane = Lane { speed_limit: *speed_limit, width: width.to_vec(), ..Lane::default() };
        let slot = features.get_mut(*feature).filter(|f| f.lane.is_none());
        let slot = slot.ok_or_else(|| file.error("lanes", feature.to_string(), "a feature, once"))?;
        slot.lane = Some(Box::new(lane));
    }
    let mut map = Map { points, features };
    for row in file.integers::<7>("lane.links")? {
        let wrong = || {
            let expected = "lane, link 0 to 6, feature, and two ranges of points that these have";
            file.error("lane.links", format!("{row:?}"), expected)
        };
        let index = |k: usize| usize::try_from(row[k]).map_err(|_| wrong());
        let (own, other) = (index(0)?, index(2)?);
        let [own_range, other_range] = [[index(3)?, index(4)?], [index(5)?, index(6)?]];
        let link = Link::from_code(row[1]).ok_or_else(wrong)?;
        let is_there = other < map.features.len()
            && match link {
                Link::Entry | Link::Exit | Link::StopSign => true,
                Link::Boundary(_) => map.has_points(own, own_range),
                Link::Neighbor(_) => map.has_points(own, own_range) && map.has_points(other, other_range),
            };
        let lane = map.features.get_mut(own).and_then(|f| f.lane.as_deref_mut());
        let (Some(lane), true) = (lane, is_there) else { return Err(wrong()) };
        match link {
            Link::Entry => lane.entries.push(other),
            Link::Exit => lane.exits.push(other),
            Link::StopSign => lane.stop_signs.push(other),
            Link::Neighbor(side) => {
                lane.neighbors[side].push(Neighbor { lane: other, own: own_range, other: other_range });
            }
            Link::Boundary(side) => lane.boundaries[side].push(Boundary { feature: other, own: own_range }),
        }
    }
    // Another program may write another order.
    Ok(map.in_order_of_ids())
}

fn lights(file: &Tensors, header: &Header) -> Result<Vec<TrafficLight>, Error> {
    let (n, frames) = (header.lights.len(), header.frames);
    let stops = file.rows::<3>("lights.stop_point", &[n, 3], MAX_COORDINATE)?;
    let states = file.bytes("lights.state", Dtype::U8, &[n, frames])?;
    let state = |code: &u8| match code {
        0 => Ok(LightState::Unknown),
        1 => Ok(LightState::Stop),
        2 => Ok(LightState::Caution),
        3 => Ok(LightState::Go),
        4 => Ok(LightState::FlashingStop),
        other => Err(file.error("lights.state", other.to_string(), "0 to 4")),
    };
    let light = |(k, (lane, stops_known)): (usize, &(String, bool))| {
        let states: Result<Vec<LightState>, Error> =
            states[k * frames..(k + 1) * frames].iter().map(state).collect();
        Ok(TrafficLight { lane: lane.clone(), stop_point: stops_known.then_some(stops[k]), states: states? })
    };
    header.lights.iter().enumerate().map(light).collect()
}
