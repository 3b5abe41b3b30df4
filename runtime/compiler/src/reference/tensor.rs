//! Tensors of the reference evaluator: numbers in rows, and where each stands.

use std::borrow::Cow;

use tract_onnx::pb::TensorProto;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::tract_hir::internal::f16;

/// A tensor in row-major order. Floats of every width are f64, and integers of every width i64.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tensor {
    pub(crate) shape: Vec<usize>,
    pub(crate) numbers: Numbers,
    /// Whether the file holds it as signed bytes: the type of a zero point is that of what is quantised.
    pub(crate) is_i8: bool,
}

/// The numbers of a tensor.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Numbers {
    Real(Vec<f64>),
    Whole(Vec<i64>),
    Truth(Vec<bool>),
}

/// Why a tensor cannot be had: a sentence's end, to which the evaluator adds the node.
pub(crate) type Failure = Cow<'static, str>;

/// `$numbers` as `$values`, whatever type they have, made to another vector of that type.
macro_rules! each_type {
    ($numbers:expr, $values:ident => $made:expr) => {
        match $numbers {
            Numbers::Real($values) => Numbers::Real($made),
            Numbers::Whole($values) => Numbers::Whole($made),
            Numbers::Truth($values) => Numbers::Truth($made),
        }
    };
}

impl Tensor {
    pub(crate) fn real(shape: Vec<usize>, numbers: Vec<f64>) -> Self {
        debug_assert_eq!(count(&shape), numbers.len());
        Self { shape, numbers: Numbers::Real(numbers), is_i8: false }
    }

    pub(crate) fn whole(shape: Vec<usize>, numbers: Vec<i64>) -> Self {
        debug_assert_eq!(count(&shape), numbers.len());
        Self { shape, numbers: Numbers::Whole(numbers), is_i8: false }
    }

    pub(crate) fn truth(shape: Vec<usize>, numbers: Vec<bool>) -> Self {
        debug_assert_eq!(count(&shape), numbers.len());
        Self { shape, numbers: Numbers::Truth(numbers), is_i8: false }
    }

    pub(crate) fn len(&self) -> usize {
        count(&self.shape)
    }

    pub(crate) fn rank(&self) -> usize {
        self.shape.len()
    }

    /// The numbers of a tensor of floats.
    pub(crate) fn reals(&self) -> Result<&[f64], Failure> {
        match &self.numbers {
            Numbers::Real(numbers) => Ok(numbers),
            _ => Err("needs floats".into()),
        }
    }

    pub(crate) fn wholes(&self) -> Result<&[i64], Failure> {
        match &self.numbers {
            Numbers::Whole(numbers) => Ok(numbers),
            _ => Err("needs integers".into()),
        }
    }

    pub(crate) fn truths(&self) -> Result<&[bool], Failure> {
        match &self.numbers {
            Numbers::Truth(numbers) => Ok(numbers),
            _ => Err("needs truth values".into()),
        }
    }

    /// All numbers as floats, true as 1.
    pub(crate) fn to_reals(&self) -> Vec<f64> {
        match &self.numbers {
            Numbers::Real(numbers) => numbers.clone(),
            Numbers::Whole(numbers) => numbers.iter().map(|n| *n as f64).collect(),
            Numbers::Truth(numbers) => numbers.iter().map(|n| f64::from(*n)).collect(),
        }
    }

    /// All numbers as integers, cut towards zero.
    pub(crate) fn to_wholes(&self) -> Vec<i64> {
        match &self.numbers {
            Numbers::Real(numbers) => numbers.iter().map(|n| *n as i64).collect(),
            Numbers::Whole(numbers) => numbers.clone(),
            Numbers::Truth(numbers) => numbers.iter().map(|n| i64::from(*n)).collect(),
        }
    }

    /// The only number.
    pub(crate) fn single(&self) -> Result<f64, Failure> {
        match self.to_reals()[..] {
            [number] => Ok(number),
            _ => Err("needs a single number".into()),
        }
    }

    /// The same numbers in another shape.
    pub(crate) fn reshaped(mut self, shape: Vec<usize>) -> Result<Self, Failure> {
        if count(&shape) != self.len() {
            let (from, to) = (&self.shape, &shape);
            return Err(format!("cannot give {from:?} the shape {to:?}").into());
        }
        self.shape = shape;
        Ok(self)
    }

    /// The numbers that stand at some places, in another shape.
    pub(crate) fn at(&self, shape: Vec<usize>, places: &[usize]) -> Self {
        let numbers =
            each_type!(&self.numbers, values => places.iter().map(|at| values[*at]).collect());
        Self { shape, numbers, is_i8: false }
    }

    /// The numbers at some places of several tensors of one type, each in the tensor beside it.
    pub(crate) fn of_parts(
        shape: Vec<usize>,
        parts: &[&Tensor],
        places: &[(usize, usize)],
    ) -> Result<Self, Failure> {
        let [first, ..] = parts else { return Err("needs an input".into()) };
        macro_rules! gathered {
            ($kind:ident, $read:ident) => {{
                let parts: Vec<_> =
                    parts.iter().map(|part| part.$read()).collect::<Result<_, _>>()?;
                Numbers::$kind(places.iter().map(|(part, at)| parts[*part][*at]).collect())
            }};
        }
        let numbers = match first.numbers {
            Numbers::Real(_) => gathered!(Real, reals),
            Numbers::Whole(_) => gathered!(Whole, wholes),
            Numbers::Truth(_) => gathered!(Truth, truths),
        };
        Ok(Self { shape, numbers, is_i8: false })
    }

    /// Repeated along sizes of one, and along new ones in front, to a larger shape.
    pub(crate) fn spread(&self, shape: &[usize]) -> Result<Self, Failure> {
        if self.shape == shape {
            return Ok(self.clone());
        }
        let strides = spread_strides(&self.shape, shape)?;
        Ok(self.at(shape.to_vec(), &places(shape, &strides, 0)))
    }

    /// A place among the sizes, counted from the end where it is negative.
    pub(crate) fn axis(&self, axis: i64) -> Result<usize, Failure> {
        axis_of(axis, self.rank())
    }

    /// What the file holds.
    pub(crate) fn read(proto: &TensorProto) -> Result<Self, Failure> {
        if proto.data_location == Some(1) {
            return Err("has its numbers in another file".into());
        }
        let size = |size: &i64| usize::try_from(*size).map_err(|_| "has a negative size".into());
        let shape: Vec<usize> = proto.dims.iter().map(size).collect::<Result<_, Failure>>()?;
        let kind = DataType::try_from(proto.data_type).unwrap_or(DataType::Undefined);
        let numbers = read_numbers(proto, kind)?;
        let len = match &numbers {
            Numbers::Real(numbers) => numbers.len(),
            Numbers::Whole(numbers) => numbers.len(),
            Numbers::Truth(numbers) => numbers.len(),
        };
        if len != count(&shape) {
            return Err(format!("holds {len} numbers for the shape {shape:?}").into());
        }
        Ok(Self { shape, numbers, is_i8: kind == DataType::Int8 })
    }
}

/// The numbers of a tensor in a file, from its bytes or from the list for its type.
fn read_numbers(proto: &TensorProto, kind: DataType) -> Result<Numbers, Failure> {
    let raw = &proto.raw_data;
    macro_rules! listed {
        ($kind:ident, $list:expr, $type:ty, $convert:expr) => {
            Numbers::$kind(if raw.is_empty() {
                $list.iter().map(|number| $convert(*number as $type)).collect()
            } else {
                raw.chunks_exact(size_of::<$type>())
                    .map(|bytes| {
                        $convert(<$type>::from_le_bytes(bytes.try_into().unwrap_or_default()))
                    })
                    .collect()
            })
        };
    }
    let half = |bits: u16| f64::from(f16::from_bits(bits).to_f32());
    let brain = |bits: u16| f64::from(f32::from_bits(u32::from(bits) << 16));
    Ok(match kind {
        DataType::Float => listed!(Real, proto.float_data, f32, f64::from),
        DataType::Double => listed!(Real, proto.double_data, f64, f64::from),
        DataType::Float16 => listed!(Real, proto.int32_data, u16, half),
        DataType::Bfloat16 => listed!(Real, proto.int32_data, u16, brain),
        DataType::Int64 => listed!(Whole, proto.int64_data, i64, i64::from),
        DataType::Int32 => listed!(Whole, proto.int32_data, i32, i64::from),
        DataType::Int16 => listed!(Whole, proto.int32_data, i16, i64::from),
        DataType::Uint16 => listed!(Whole, proto.int32_data, u16, i64::from),
        DataType::Int8 => listed!(Whole, proto.int32_data, i8, i64::from),
        DataType::Uint8 => listed!(Whole, proto.int32_data, u8, i64::from),
        DataType::Uint32 => listed!(Whole, proto.uint64_data, u32, i64::from),
        DataType::Uint64 => listed!(Whole, proto.uint64_data, u64, |number| number as i64),
        DataType::Bool => listed!(Truth, proto.int32_data, u8, |number| number != 0),
        other => return Err(format!("is of type {other:?}").into()),
    })
}

pub(crate) fn count(shape: &[usize]) -> usize {
    shape.iter().product()
}

/// How far apart neighbours along each size stand.
pub(crate) fn strides(shape: &[usize]) -> Vec<isize> {
    let mut strides = vec![1; shape.len()];
    for axis in (1..shape.len()).rev() {
        strides[axis - 1] = strides[axis] * shape[axis] as isize;
    }
    strides
}

/// The places of a walk through a shape, by how far apart its neighbours stand.
pub(crate) fn places(shape: &[usize], strides: &[isize], first: isize) -> Vec<usize> {
    let mut places = vec![first];
    for (size, stride) in shape.iter().zip(strides) {
        let along = |place: &isize| {
            let place = *place;
            (0..*size as isize).map(move |step| place + step * stride)
        };
        places = places.iter().flat_map(along).collect();
    }
    places.into_iter().map(|place| place as usize).collect()
}

/// The shape that both are repeated to.
pub(crate) fn common_shape(one: &[usize], other: &[usize]) -> Result<Vec<usize>, Failure> {
    let rank = one.len().max(other.len());
    let size = |shape: &[usize], axis: usize| {
        (axis + shape.len()).checked_sub(rank).map_or(1, |axis| shape[axis])
    };
    let common = |axis: usize| match (size(one, axis), size(other, axis)) {
        (one, other) if one == other || other == 1 => Ok(one),
        (1, other) => Ok(other),
        _ => Err(format!("{one:?} and {other:?} do not go together").into()),
    };
    (0..rank).map(common).collect()
}

/// How far apart neighbours stand in a tensor that is repeated to a larger shape.
pub(super) fn spread_strides(from: &[usize], to: &[usize]) -> Result<Vec<isize>, Failure> {
    if common_shape(from, to)? != to {
        return Err(format!("{from:?} cannot be repeated to {to:?}").into());
    }
    let mut all = vec![0; to.len() - from.len()];
    let own = from.iter().zip(strides(from));
    all.extend(own.map(|(size, stride)| if *size == 1 { 0 } else { stride }));
    Ok(all)
}

pub(crate) fn axis_of(axis: i64, rank: usize) -> Result<usize, Failure> {
    let from_front = if axis < 0 { axis + rank as i64 } else { axis };
    let axis = usize::try_from(from_front).ok().filter(|axis| *axis < rank);
    axis.ok_or_else(|| "names an axis that is not there".into())
}
