//! The functions and classes that a scene file may name. All others are refused, and none is executed.

/// Globals that scene files use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Global {
    /// `numpy.core.multiarray._reconstruct` and its `_core` twin.
    Reconstruct,
    /// `numpy.core.numeric._frombuffer` and its `_core` twin (protocol 5).
    FromBuffer,
    /// `numpy.core.multiarray.scalar` and its `_core` twin.
    Scalar,
    /// `numpy.ndarray`.
    NdArray,
    /// `numpy.dtype`.
    Dtype,
    /// `_codecs.encode`, by which protocol 2 writes bytes.
    Encode,
    /// `collections.defaultdict`.
    DefaultDict,
    /// `builtins.int`, a defaultdict's factory.
    Int,
    /// `builtins.set`.
    Set,
    /// `__builtin__.bytes` without arguments, by which protocol 2 writes empty bytes.
    Bytes,
    /// `metadrive.utils.math.Vector`, a tuple with arithmetic: MetaDrive's positions of lights. Before 0.4 its
    /// module was `math_utils`.
    Vector,
    /// `metadrive.scenario.scenario_description.ScenarioDescription`, a dict with methods: a scene that MetaDrive did not
    /// turn into a plain dict.
    ScenarioDescription,
    /// `metadrive.component.lane.point_lane.PointLane`, the lane of a driver, which MetaDrive leaves in the metadata of
    /// some tracks. No reader uses it; it is kept as the dict of its attributes.
    PointLane,
    /// `shapely.io.from_wkb`, the outline of a [`Global::PointLane`], which repeats its polygon; read as None.
    FromWkb,
}

impl Global {
    /// Parses the name of a global. `__builtin__` is a module of Python 2; Python 3 accepts it only in protocol 2, where it
    /// writes `__builtin__.long` and `__builtin__.bytes` itself.
    pub(super) fn from_name(module: &[u8], name: &[u8], protocol: u8) -> Option<Self> {
        if module == b"__builtin__" && protocol > 2 {
            return None;
        }
        Some(match (module, name) {
            (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"_reconstruct") => Self::Reconstruct,
            (b"numpy.core.numeric" | b"numpy._core.numeric", b"_frombuffer") => Self::FromBuffer,
            (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"scalar") => Self::Scalar,
            (b"numpy", b"ndarray") => Self::NdArray,
            (b"numpy", b"dtype") => Self::Dtype,
            (b"_codecs", b"encode") => Self::Encode,
            (b"collections", b"defaultdict") => Self::DefaultDict,
            // In protocol 2, Python 3 writes `int` as Python 2's `long`.
            (b"builtins" | b"__builtin__", b"int") | (b"__builtin__", b"long") => Self::Int,
            (b"builtins" | b"__builtin__", b"set") => Self::Set,
            (b"__builtin__", b"bytes") => Self::Bytes,
            (b"metadrive.utils.math" | b"metadrive.utils.math_utils", b"Vector") => Self::Vector,
            (b"metadrive.scenario.scenario_description", b"ScenarioDescription") => Self::ScenarioDescription,
            (b"metadrive.component.lane.point_lane", b"PointLane") => Self::PointLane,
            (b"shapely.io", b"from_wkb") => Self::FromWkb,
            _ => return None,
        })
    }
}
