//! Pictures of another size: every axis that changes is a product with a constant matrix, whose columns weigh the two
//! nearest places.

use super::Parts;

/// Linear interpolation, as it is without smoothing and without numbers from outside of the picture.
pub(super) fn resize(parts: &mut Parts<'_>) -> Option<()> {
    let is_plain = ["linear", "bilinear"].contains(&&*parts.text("mode", "nearest"))
        && parts.whole("antialias") == 0
        && parts.text("keep_aspect_ratio_policy", "stretch") == "stretch";
    if !is_plain {
        return None;
    }
    let x = parts.input(0)?;
    let (_, sizes) = parts.fact(&x)?;
    let axes = match parts.attribute("axes") {
        Some(axes) => axes.ints.clone(),
        None => (0..sizes.len() as i64).collect(),
    };
    let scales = scales(parts, &axes, &sizes)?;
    let how = match parts.is_upsample() || parts.version() < 11 {
        true => "asymmetric".to_owned(),
        false => parts.text("coordinate_transformation_mode", "half_pixel"),
    };
    let mut found = x;
    for (axis, (length, scale)) in axes.iter().zip(scales) {
        let axis =
            usize::try_from(if *axis < 0 { axis + sizes.len() as i64 } else { *axis }).ok()?;
        let size = usize::try_from(*sizes.get(axis)?).ok()?;
        if length == size && scale == 1.0 {
            continue;
        }
        let weights = weights([size, length], scale, &how)?;
        let weights = parts.matrix([size, length], weights);
        let last = sizes.len() - 1;
        let mut order: Vec<i64> = (0..sizes.len() as i64).collect();
        order.swap(axis, last);
        let turned = parts.transposed(&found, &order);
        let product = parts.add("MatMul", &[&turned, &weights]);
        found = parts.transposed(&product, &order);
    }
    parts.give(0, &found)
}

/// The length of every axis and by how much it grows.
fn scales(parts: &Parts<'_>, axes: &[i64], sizes: &[i64]) -> Option<Vec<(usize, f64)>> {
    let before =
        |axis: &i64| sizes.get(if *axis < 0 { axis + sizes.len() as i64 } else { *axis } as usize);
    let sizes: Vec<f64> =
        axes.iter().map(|axis| Some(*before(axis)? as f64)).collect::<Option<_>>()?;
    let is_old = parts.is_upsample() || parts.version() < 11;
    let attribute = parts.attribute("scales").map(|scales| scales.floats.clone());
    let scales = match attribute {
        Some(scales) => scales.into_iter().map(f64::from).collect(),
        None => parts
            .computed(&parts.input(if is_old { 1 } else { 2 }).unwrap_or_default())
            .unwrap_or_default(),
    };
    if !scales.is_empty() {
        let lengths = sizes
            .iter()
            .zip(&scales)
            .map(|(size, scale)| ((size * scale).floor() as usize, *scale));
        return (scales.len() == sizes.len()).then(|| lengths.collect());
    }
    let lengths = parts.computed(&parts.input(3)?)?;
    let scales = sizes.iter().zip(&lengths).map(|(size, length)| (*length as usize, length / size));
    (lengths.len() == sizes.len()).then(|| scales.collect())
}

/// What every place of the result takes of every one of the picture `[size, length]`.
fn weights([size, length]: [usize; 2], scale: f64, how: &str) -> Option<Vec<f32>> {
    let last = size as f64 - 1.0;
    let place = |at: usize| {
        let at = at as f64;
        Some(match how {
            "asymmetric" => at / scale,
            "align_corners" if length > 1 => at * last / (length as f64 - 1.0),
            "align_corners" => 0.0,
            "pytorch_half_pixel" if length <= 1 => 0.0,
            "half_pixel" | "pytorch_half_pixel" => (at + 0.5) / scale - 0.5,
            _ => return None,
        })
    };
    let mut weights = vec![0.0; size * length];
    for at in 0..length {
        let place = place(at)?.clamp(0.0, last);
        let (low, share) = (place.floor() as usize, place.fract());
        for (row, share) in [(low, 1.0 - share), ((low + 1).min(size - 1), share)] {
            *weights.get_mut(row * length + at)? += share as f32;
        }
    }
    Some(weights)
}
