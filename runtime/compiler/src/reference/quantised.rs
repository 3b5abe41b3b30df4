//! Operators of quantised networks: whole numbers with a scale and a zero point.

use std::ops::Range;

use tract_onnx::pb::NodeProto;

use super::products::{convolution, product};
use super::tensor::{Failure, Tensor};
use super::{Call, Found, one};

pub(super) fn evaluate(call: &Call<'_>) -> Found {
    match call.operator() {
        "QuantizeLinear" => {
            let input = call.input(0)?;
            let (scale, zero) = parameters(call, input, 1, 2)?;
            one(quantised(input, &scale, &zero, range(call.given(2))))
        }
        "DequantizeLinear" => one(dequantised(call, [0, 1, 2])?),
        "DynamicQuantizeLinear" => dynamic(call),
        "MatMulInteger" => whole(product(&shifted(call, 0, 2)?, &shifted(call, 1, 3)?)?),
        "ConvInteger" => {
            whole(convolution(call, &shifted(call, 0, 2)?, &shifted(call, 1, 3)?, None)?)
        }
        _ => Ok(None),
    }
}

/// A product of whole numbers on scales as the nodes that it stands for, so that each rounds by itself.
pub(super) fn parted(node: NodeProto) -> Vec<NodeProto> {
    if node.op_type != "QLinearMatMul" {
        return vec![node];
    }
    let name = |part: &str| format!("{}.{part}", node.output.first().map_or("", String::as_str));
    let part = |operator: &str, inputs: &[String], output: String| NodeProto {
        op_type: operator.to_owned(),
        name: node.name.clone(),
        input: inputs.to_vec(),
        output: vec![output],
        ..NodeProto::default()
    };
    let given = |slots: Range<usize>| node.input.get(slots).unwrap_or_default().to_vec();
    let [left, right, sums] = ["left", "right", "sums"].map(name);
    vec![
        part("DequantizeLinear", &given(0..3), left.clone()),
        part("DequantizeLinear", &given(3..6), right.clone()),
        part("MatMul", &[left, right], sums.clone()),
        part("QuantizeLinear", &[vec![sums], given(6..8)].concat(), name("whole")),
        NodeProto {
            output: node.output.clone(),
            ..part("Identity", &[name("whole")], String::new())
        },
    ]
}

/// Whole numbers less their zero point.
fn shifted(call: &Call<'_>, index: usize, zero: usize) -> Result<Tensor, Failure> {
    let input = call.input(index)?;
    let zero = call.given(zero).map_or(Ok(0.0), Tensor::single)?;
    let numbers = input.to_reals().iter().map(|x| x - zero).collect();
    Ok(Tensor::real(input.shape.clone(), numbers))
}

fn whole(sums: Tensor) -> Found {
    one(Tensor::whole(sums.shape.clone(), sums.to_wholes()))
}

/// Scale and zero point of every number: one for all, or one for each place along an axis.
fn parameters(
    call: &Call<'_>,
    input: &Tensor,
    scale: usize,
    zero: usize,
) -> Result<(Vec<f64>, Vec<f64>), Failure> {
    let spread = |tensor: &Tensor| -> Result<Vec<f64>, Failure> {
        if tensor.len() == 1 {
            return Ok(vec![tensor.single()?; input.len()]);
        }
        let mut shape = vec![1; input.rank()];
        shape[input.axis(call.int("axis", 1))?] = tensor.len();
        Ok(tensor.clone().reshaped(shape)?.spread(&input.shape)?.to_reals())
    };
    let zero = call.given(zero).map(spread).transpose()?;
    Ok((spread(call.input(scale)?)?, zero.unwrap_or_else(|| vec![0.0; input.len()])))
}

/// The numbers that the type of a zero point holds: bytes without sign where there is none.
fn range(zero: Option<&Tensor>) -> (f64, f64) {
    if zero.is_some_and(|zero| zero.is_i8) { (-128.0, 127.0) } else { (0.0, 255.0) }
}

fn quantised(input: &Tensor, scale: &[f64], zero: &[f64], (least, most): (f64, f64)) -> Tensor {
    let numbers = input.to_reals().into_iter().zip(scale).zip(zero);
    let number = |((x, scale), zero): ((f64, &f64), &f64)| {
        ((x / scale).round_ties_even() + zero).clamp(least, most) as i64
    };
    Tensor::whole(input.shape.clone(), numbers.map(number).collect())
}

fn dequantised(call: &Call<'_>, [input, scale, zero]: [usize; 3]) -> Result<Tensor, Failure> {
    let input = call.input(input)?;
    let (scale, zero) = parameters(call, input, scale, zero)?;
    let numbers = input.to_reals().into_iter().zip(scale).zip(zero);
    let numbers = numbers.map(|((x, scale), zero)| (x - zero) * scale).collect();
    Ok(Tensor::real(input.shape.clone(), numbers))
}

fn dynamic(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let numbers = input.reals()?;
    let least = numbers.iter().copied().fold(0.0, f64::min);
    let most = numbers.iter().copied().fold(0.0, f64::max);
    let scale = (most - least) / 255.0;
    let zero =
        if scale == 0.0 { 0.0 } else { (-least / scale).clamp(0.0, 255.0).round_ties_even() };
    let all = |number: f64| vec![number; numbers.len()];
    let found =
        quantised(input, &all(if scale == 0.0 { 1.0 } else { scale }), &all(zero), (0.0, 255.0));
    Ok(Some(vec![
        found,
        Tensor::real(Vec::new(), vec![scale]),
        Tensor::whole(Vec::new(), vec![zero as i64]),
    ]))
}
