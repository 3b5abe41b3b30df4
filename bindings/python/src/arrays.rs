//! NumPy's arrays in and out.
//!
//! A C-contiguous float32 array is read where it lies. Whatever else NumPy makes float32 of without leaving its kind of
//! number behind (lists, other floats, whole numbers, flags, views with gaps) is converted, once. The rest is refused.

use numpy::ndarray::{ArrayView, IxDyn};
use numpy::{
    Element, PyArray, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sortie_plans::ValueType;

/// Numbers of an input: C-contiguous.
pub(crate) type Numbers<'py> = PyReadonlyArrayDyn<'py, f32>;

/// The numbers of what was given for an input.
pub(crate) fn numbers<'py>(name: &str, given: &Bound<'py, PyAny>) -> PyResult<Numbers<'py>> {
    if let Ok(array) = given.cast::<PyArrayDyn<f32>>()
        && array.is_c_contiguous()
    {
        let numbers = array.try_readonly()?;
        // Nor are numbers read that begin between two of them.
        if numbers.as_slice().is_ok() {
            return Ok(numbers);
        }
    }
    converted(name, given)
}

/// A copy as float32, row by row.
#[cold]
fn converted<'py>(name: &str, given: &Bound<'py, PyAny>) -> PyResult<Numbers<'py>> {
    let py = given.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let float32 = numpy.getattr(intern!(py, "float32"))?;
    let array = numpy.call_method1(intern!(py, "asarray"), (given,))?;
    let kind = array.getattr(intern!(py, "dtype"))?;
    let fits = numpy.call_method1(intern!(py, "can_cast"), (&kind, &float32, "same_kind"))?;
    if !fits.is_truthy()? {
        return Err(PyTypeError::new_err(format!(
            "`{name}` holds {kind}, needed are numbers that become float32"
        )));
    }
    let options = PyDict::new(py);
    options.set_item("dtype", float32)?;
    options.set_item("order", "C")?;
    let array = numpy.call_method(intern!(py, "array"), (array,), Some(&options))?;
    Ok(array.cast_into::<PyArrayDyn<f32>>()?.try_readonly()?)
}

/// The slice of an array that is contiguous.
pub(crate) fn slice<'a>(numbers: &'a Numbers<'_>) -> PyResult<&'a [f32]> {
    Ok(numbers.as_slice()?)
}

/// A mask as 0 and 1, whatever flags or whole numbers it is made of; as many as `want` in all.
pub(crate) fn mask(name: &str, given: &Bound<'_, PyAny>, want: &[usize]) -> PyResult<Vec<u16>> {
    let py = given.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let array = numpy.call_method1(intern!(py, "asarray"), (given,))?;
    let array = array.cast_into::<PyUntypedArray>()?;
    let kind = array.dtype().kind();
    if !matches!(kind, b'b' | b'i' | b'u') {
        return Err(PyTypeError::new_err(format!(
            "`{name}` holds {}, needed are flags or whole numbers, 0 = not",
            array.dtype()
        )));
    }
    if array.shape() != want {
        return Err(PyValueError::new_err(format!(
            "`{name}` has the shape {:?}, needed is {want:?}",
            array.shape()
        )));
    }
    let flags = array.call_method1(intern!(py, "astype"), ("bool",))?;
    let flags = flags.cast_into::<PyArrayDyn<bool>>()?.try_readonly()?;
    Ok(flags.as_array().iter().map(|flag| u16::from(*flag)).collect())
}

/// A mask as the numbers of an input; everything where none was given.
pub(crate) fn flags(mask: &[u16], length: usize) -> PyResult<Vec<f32>> {
    match mask.len() {
        0 => Ok(vec![1.0; length]),
        got if got == length => Ok(mask.iter().map(|flag| f32::from(*flag)).collect()),
        got => {
            Err(PyValueError::new_err(format!("`available` has {got} flags, needed are {length}")))
        }
    }
}

/// Whole numbers, one after the other.
pub(crate) fn whole(name: &str, given: &Bound<'_, PyAny>) -> PyResult<Vec<i64>> {
    let py = given.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let array = numpy.call_method1(intern!(py, "asarray"), (given,))?;
    let array = array.cast_into::<PyUntypedArray>()?;
    if !matches!(array.dtype().kind(), b'i' | b'u') || array.ndim() != 1 {
        return Err(PyTypeError::new_err(format!(
            "`{name}` holds {} {:?}, needed are whole numbers in a row",
            array.dtype(),
            array.shape()
        )));
    }
    let array = array.call_method1(intern!(py, "astype"), ("int64",))?;
    Ok(array.cast_into::<PyArrayDyn<i64>>()?.try_readonly()?.as_array().iter().copied().collect())
}

/// A new array with a copy of these numbers.
pub(crate) fn array<'py, T: Element>(
    py: Python<'py>,
    shape: &[usize],
    numbers: &[T],
) -> PyResult<Bound<'py, PyArray<T, IxDyn>>> {
    let view = ArrayView::from_shape(IxDyn(shape), numbers);
    let view = view.map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok(PyArray::from_array(py, &view))
}

/// A new array of the type that the file has; f64 becomes float32, in which everything is computed.
pub(crate) fn array_as<'py>(
    py: Python<'py>,
    kind: ValueType,
    shape: &[usize],
    numbers: &[f32],
) -> PyResult<Bound<'py, PyAny>> {
    if kind.is_float() {
        return Ok(array(py, shape, numbers)?.into_any());
    }
    if kind == ValueType::I64 {
        let whole: Vec<i64> = numbers.iter().map(|number| *number as i64).collect();
        return Ok(array(py, shape, &whole)?.into_any());
    }
    let name = match kind {
        ValueType::I32 => "int32",
        ValueType::U8 => "uint8",
        _ => "bool",
    };
    array(py, shape, numbers)?.call_method1(intern!(py, "astype"), (name,))
}
