//! Values of JSON and arrays, from and to Python.

use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::{
    exceptions::{PyOverflowError, PyTypeError, PyValueError},
    intern,
    prelude::*,
    types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple},
};
use sage_core::{
    geometry::Point,
    motion::{HORIZON, Trajectory},
};
use serde::Serialize;
use serde_json::{Map, Number, Value};

use crate::errors::OptionError;

/// What pickle makes a value anew from: a function and its arguments.
pub(crate) type Reduced<'py, A> = (Bound<'py, PyAny>, A);

/// What a type is in JSON, as values of Python: dictionaries, lists, numbers.
pub(crate) fn from_serde<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let value = serde_json::to_value(value).map_err(|error| PyValueError::new_err(error.to_string()))?;
    from_json(py, &value)
}

/// A value of JSON.
pub(crate) fn from_json<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(is) => PyBool::new(py, *is).to_owned().into_any(),
        Value::Number(number) => match (number.as_i64(), number.as_u64()) {
            (Some(number), _) => number.into_pyobject(py)?.into_any(),
            (None, Some(number)) => number.into_pyobject(py)?.into_any(),
            (None, None) => PyFloat::new(py, number.as_f64().unwrap_or(f64::NAN)).into_any(),
        },
        Value::String(text) => PyString::new(py, text).into_any(),
        Value::Array(items) => {
            let items = items.iter().map(|item| from_json(py, item)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, items)?.into_any()
        }
        Value::Object(fields) => {
            let dict = PyDict::new(py);
            for (key, value) in fields {
                dict.set_item(key, from_json(py, value)?)?;
            }
            dict.into_any()
        }
    })
}

/// Levels of lists and dictionaries in options at most.
const DEEPEST: usize = 32;

/// A value of Python as JSON.
///
/// *Errors*: a value that JSON has no word for.
pub(crate) fn to_json(what: &str, value: &Bound<'_, PyAny>, depth: usize) -> PyResult<Value> {
    let wrong = |found: String| {
        OptionError::new_err(format!("{what} holds {found}; expected numbers, texts, lists and dictionaries"))
    };
    if depth > DEEPEST {
        return Err(wrong(format!("more than {DEEPEST} levels")));
    }
    if value.is_none() {
        return Ok(Value::Null);
    }
    if let Ok(is) = value.cast::<PyBool>() {
        return Ok(is.is_true().into());
    }
    if value.is_instance_of::<PyInt>() {
        let number: i64 = value.extract().map_err(|_| wrong(format!("{value}")))?;
        return Ok(number.into());
    }
    if value.is_instance_of::<PyFloat>() {
        let number: f64 = value.extract()?;
        return Number::from_f64(number).map(Value::Number).ok_or_else(|| wrong(format!("{number}")));
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(text.to_str()?.into());
    }
    if let Ok(dict) = value.cast::<PyDict>() {
        let mut fields = Map::new();
        // A list of them: the dictionary may change while values are read.
        for item in dict.items() {
            let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
            let key =
                key.cast::<PyString>().map_err(|_| wrong(format!("the key {key}")))?.to_str()?.to_owned();
            fields.insert(key, to_json(what, &value, depth + 1)?);
        }
        return Ok(Value::Object(fields));
    }
    // Arrays and numbers of NumPy.
    if value.hasattr(intern!(value.py(), "tolist"))? {
        return to_json(what, &value.call_method0(intern!(value.py(), "tolist"))?, depth + 1);
    }
    if !value.is_instance_of::<PyList>() && !value.is_instance_of::<PyTuple>() {
        return Err(wrong(format!("a {}", class_of(value))));
    }
    let items = value.try_iter()?;
    items.map(|item| to_json(what, &item?, depth + 1)).collect::<PyResult<Vec<_>>>().map(Value::Array)
}

/// Name of the class of a value.
pub(crate) fn class_of(value: &Bound<'_, PyAny>) -> String {
    value.get_type().name().map_or("value".to_owned(), |name| name.to_string())
}

/// An array of some shape, from its values in the order of rows.
pub(crate) fn array<'py, T: numpy::Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let array = PyArray1::from_vec(py, values);
    // A reshaped array is a second object of Python.
    if shape == [array.len()] { Ok(array.to_dyn().clone()) } else { array.reshape(shape) }
}

/// The same, which cannot be written to, because it is shared.
pub(crate) fn shared_array<T: numpy::Element>(
    py: Python<'_>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Py<PyAny>> {
    // A view of what cannot be written to cannot be made writeable again.
    let owner = PyArray1::from_vec(py, values);
    owner.call_method1(intern!(py, "setflags"), (false,))?;
    Ok(owner.reshape(shape)?.into_any().unbind())
}

/// Shape and values of an array or of nested lists of numbers.
///
/// *Errors*: anything else.
pub(crate) fn numbers(
    what: &str,
    value: &Bound<'_, PyAny>,
    expected: &str,
) -> PyResult<(Vec<usize>, Vec<f64>)> {
    let py = value.py();
    let wrong = |found: String| OptionError::new_err(format!("{what} is {found}; expected {expected}"));
    let numpy = py.import(intern!(py, "numpy"))?;
    let found = || format!("a {}", class_of(value));
    let is_wrong = |error: &PyErr| {
        error.is_instance_of::<PyTypeError>(py)
            || error.is_instance_of::<PyValueError>(py)
            || error.is_instance_of::<PyOverflowError>(py)
    };
    let refused = |error: PyErr| match is_wrong(&error) {
        true => wrong(format!("{} ({})", found(), error.value(py))),
        false => error,
    };
    let given = numpy.call_method1(intern!(py, "asarray"), (value,)).map_err(refused)?;
    // Complex numbers, texts and times would be cut or read as numbers, and a mask would be lost.
    let kind: String = given.getattr(intern!(py, "dtype"))?.getattr(intern!(py, "kind"))?.extract()?;
    if !["f", "i", "u", "b"].contains(&&*kind) || value.hasattr(intern!(py, "mask"))? {
        return Err(wrong(format!("{} of {}", found(), given.getattr(intern!(py, "dtype"))?)));
    }
    let array = numpy.call_method1(intern!(py, "ascontiguousarray"), (given, intern!(py, "float64")));
    let array = array.map_err(refused)?;
    let array: PyReadonlyArrayDyn<'_, f64> = array.extract().map_err(|_| wrong(found()))?;
    Ok((array.shape().to_vec(), array.as_slice()?.to_vec()))
}

/// Trajectories of an array of shape (n, 80, 2), or one of shape (80, 2).
///
/// *Errors*: another shape, and points that no trajectory has.
pub(crate) fn trajectories(what: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<Trajectory>> {
    const EXPECTED: &str = "positions of shape (n, 80, 2) or (80, 2): x and y in metres, one every 0.1 s";
    let (shape, values) = numbers(what, value, EXPECTED)?;
    let count = match &shape[..] {
        [HORIZON, 2] => 1,
        [count, HORIZON, 2] => *count,
        _ => {
            return Err(OptionError::new_err(format!("{what} has the shape {shape:?}; expected {EXPECTED}")));
        }
    };
    let (points, _) = values.as_chunks::<2>();
    let named = |k: usize| if shape.len() == 2 { what.to_owned() } else { format!("{what}, number {k}") };
    let all = (0..count).map(|k| Trajectory::new(&named(k), points[k * HORIZON..(k + 1) * HORIZON].to_vec()));
    all.collect::<Result<Vec<_>, _>>().map_err(|error| OptionError::new_err(error.to_string()))
}

/// Points one after another.
pub(crate) fn flat<'a>(points: impl IntoIterator<Item = &'a Point>) -> Vec<f64> {
    points.into_iter().flatten().copied().collect()
}
