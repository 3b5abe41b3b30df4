//! Numbers in another order: transposed, cut out, repeated, beside each other.

use std::cmp::Reverse;

use sortie_core::internal::ops::{Arrange, Choice, Combination, Flag, LookUp, Op, Place};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::{OneHot, Pad, PadMode, Slice};
use tract_onnx::tract_core::ops::change_axes::AxisOp;
use tract_onnx::tract_core::ops::downsample::Downsample;
use tract_onnx::tract_hir::internal::DimLike;

use super::values::{Value, numbers};
use super::{Dimension, Lowered, Lowering};

/// The steps between neighbours along every axis.
pub(super) fn strides(shape: &[usize]) -> Vec<usize> {
    let mut strides: Vec<usize> = shape
        .iter()
        .rev()
        .scan(1, |step, size| {
            let own = *step;
            *step *= size;
            Some(own)
        })
        .collect();
    strides.reverse();
    strides
}

/// The same copy in as few dimensions as possible.
fn merged(dimensions: &[Dimension]) -> Vec<Dimension> {
    let mut merged: Vec<Dimension> = Vec::new();
    for inner in dimensions.iter().filter(|dimension| dimension.size != 1) {
        match merged.last_mut() {
            Some(outer)
                if outer.from == inner.size * inner.from && outer.to == inner.size * inner.to =>
            {
                *outer = Dimension { size: outer.size * inner.size, ..*inner };
            }
            _ => merged.push(*inner),
        }
    }
    merged
}

impl Lowering<'_> {
    /// Adds a copy, slowest dimension first.
    pub(super) fn arrange(
        &mut self,
        node: &TypedNode,
        from: Place,
        to: Place,
        dimensions: &[Dimension],
    ) -> Lowered<()> {
        const MOST: usize = 4;
        let merged = merged(dimensions);
        if merged.len() > MOST {
            return Err(self.unsupported(node, "it moves numbers along more than four dimensions"));
        }
        let (mut sizes, mut from_strides, mut to_strides) = ([1; MOST], [0; MOST], [0; MOST]);
        for (index, dimension) in (MOST - merged.len()..).zip(&merged) {
            sizes[index] = dimension.size as u32;
            from_strides[index] = dimension.from as u32;
            to_strides[index] = dimension.to as u32;
        }
        self.ops.push(Op::Arrange(Arrange { from, to, sizes, from_strides, to_strides }));
        Ok(())
    }

    /// The axes of a value in another order, behind each other.
    pub(super) fn permuted(
        &mut self,
        node: &TypedNode,
        value: &Value,
        order: &[usize],
    ) -> Lowered<Place> {
        let steps = strides(&value.shape);
        let sizes: Vec<usize> = order.iter().map(|axis| value.shape[*axis]).collect();
        self.copied(node, value.place, &sizes, order.iter().map(|axis| steps[*axis]))
    }

    /// Numbers whose sizes and steps along every axis are given, behind each other.
    pub(super) fn copied(
        &mut self,
        node: &TypedNode,
        from: Place,
        sizes: &[usize],
        steps: impl Iterator<Item = usize>,
    ) -> Lowered<Place> {
        let dimensions: Vec<Dimension> = (sizes.iter().zip(steps).zip(strides(sizes)))
            .map(|((size, from), to)| Dimension { size: *size, from, to })
            .collect();
        let is_moved = merged(&dimensions).iter().any(|d| d.from != d.to);
        if !is_moved {
            return Ok(from);
        }
        let to = self.arena.place(from.len as usize);
        self.arrange(node, from, to, &dimensions)?;
        Ok(to)
    }

    /// An operand repeated to a shape of as many axes, in the order in which the function at hand works.
    pub(super) fn broadcast(
        &mut self,
        node: &TypedNode,
        slot: usize,
        shape: &[usize],
    ) -> Lowered<Place> {
        let (outlet, value) = (self.outlet(node, slot)?, self.operand(node, slot)?);
        let count: usize = shape.iter().product();
        let picture = self.values.as_picture.filter(|_| !self.values.stands(outlet));
        if value.place.len as usize == count && picture.is_none() {
            return Ok(value.place);
        }
        if value.shape.len() != shape.len() {
            return Err(self.unsupported(node, "its operands have other numbers of axes"));
        }
        let from = strides(&value.shape);
        let to = picture.and_then(|picture| picture.strides(shape));
        let to = to.unwrap_or_else(|| strides(shape));
        let mut dimensions: Vec<Dimension> = (0..shape.len())
            .map(|axis| Dimension {
                size: shape[axis],
                from: if value.shape[axis] == 1 { 0 } else { from[axis] },
                to: to[axis],
            })
            .collect();
        dimensions.sort_by_key(|dimension| Reverse(dimension.to));
        let place = self.arena.place(count);
        self.arrange(node, value.place, place, &dimensions)?;
        Ok(place)
    }

    pub(super) fn axes(&mut self, node: &TypedNode, op: &AxisOp) -> Lowered<()> {
        let outlet = self.outlet(node, 0)?;
        let picture = self.values.picture(outlet);
        let AxisOp::Move(from, to) = *op else {
            if let Some(picture) = picture {
                self.values.insert_picture((node.id, 0).into(), picture);
                return Ok(());
            }
            let place = self.operand(node, 0)?.place;
            return self.give(node, 0, place);
        };
        let shape = self.shape(self.model.node(outlet.node), outlet.slot)?;
        let mut order: Vec<usize> = (0..shape.len()).collect();
        let axis = order.remove(from);
        order.insert(to, axis);
        let place = self.reordered(node, 0, &order)?;
        self.give(node, 0, place)
    }

    /// The axes of an operand in another order; a picture is read as it stands.
    pub(super) fn reordered(
        &mut self,
        node: &TypedNode,
        slot: usize,
        order: &[usize],
    ) -> Lowered<Place> {
        let outlet = self.outlet(node, slot)?;
        let shape = self.shape(self.model.node(outlet.node), outlet.slot)?;
        let picture = self.values.picture(outlet);
        let steps = picture.and_then(|picture| Some((picture.place, picture.strides(&shape)?)));
        let Some((place, steps)) = steps else {
            let key = (outlet, order.to_vec());
            if let Some(place) = self.values.permuted.get(&key) {
                return Ok(*place);
            }
            let value = self.operand(node, slot)?;
            let place = self.permuted(node, &value, order)?;
            self.values.permuted.insert(key, place);
            return Ok(place);
        };
        let sizes: Vec<usize> = order.iter().map(|axis| shape[*axis]).collect();
        self.copied(node, place, &sizes, order.iter().map(|axis| steps[*axis]))
    }

    pub(super) fn slice(&mut self, node: &TypedNode, slice: &Slice) -> Lowered<()> {
        let start = slice.start.to_usize();
        let start = start.map_err(|_| self.unsupported(node, "its start is left open"))?;
        let (value, shape) = (self.operand(node, 0)?, self.shape(node, 0)?);
        let place = self.part(node, &value, slice.axis, start, &shape)?;
        self.give(node, 0, place)
    }

    /// A part of a value along one axis.
    fn part(
        &mut self,
        node: &TypedNode,
        value: &Value,
        axis: usize,
        start: usize,
        shape: &[usize],
    ) -> Lowered<Place> {
        let steps = strides(&value.shape);
        let len: usize = shape.iter().product();
        let first = value.place.offset as usize + start * steps[axis];
        if value.shape[..axis].iter().all(|size| *size == 1) {
            return Ok(Place { offset: first as u32, len: len as u32 });
        }
        let own = strides(shape);
        let dimensions: Vec<Dimension> = (0..shape.len())
            .map(|axis| Dimension { size: shape[axis], from: steps[axis], to: own[axis] })
            .collect();
        let rest = value.place.len as usize - start * steps[axis];
        let from = Place { offset: first as u32, len: rest as u32 };
        let to = self.arena.place(len);
        self.arrange(node, from, to, &dimensions)?;
        Ok(to)
    }

    /// Every so many parts of a value along one axis.
    pub(super) fn every(&mut self, node: &TypedNode, every: &Downsample) -> Lowered<()> {
        let Ok(stride) = usize::try_from(every.stride) else { return self.moved(node, &[0]) };
        let (value, shape) = (self.operand(node, 0)?, self.shape(node, 0)?);
        let (steps, own) = (strides(&value.shape), strides(&shape));
        let step =
            |axis: usize| if axis == every.axis { steps[axis] * stride } else { steps[axis] };
        let dimensions: Vec<Dimension> = (0..shape.len())
            .map(|axis| Dimension { size: shape[axis], from: step(axis), to: own[axis] })
            .collect();
        let skipped = (every.modulo * steps[every.axis]) as u32;
        let from = Place {
            offset: value.place.offset + skipped,
            len: value.place.len.saturating_sub(skipped),
        };
        let to = self.arena.place(shape.iter().product());
        self.arrange(node, from, to, &dimensions)?;
        self.give(node, 0, to)
    }

    pub(super) fn concat(&mut self, node: &TypedNode, axis: usize) -> Lowered<()> {
        let shape = self.shape(node, 0)?;
        let own = strides(&shape);
        let whole = self.arena.place(shape.iter().product());
        let mut start = 0;
        for slot in 0..node.inputs.len() {
            let value = self.operand(node, slot)?;
            let steps = strides(&value.shape);
            let dimensions: Vec<Dimension> = (0..shape.len())
                .map(|axis| Dimension { size: value.shape[axis], from: steps[axis], to: own[axis] })
                .collect();
            let skipped = (start * own[axis]) as u32;
            let to = Place { offset: whole.offset + skipped, len: whole.len - skipped };
            self.arrange(node, value.place, to, &dimensions)?;
            start += value.shape[axis];
        }
        self.give(node, 0, whole)
    }

    /// A value with constant numbers around it.
    pub(super) fn pad(&mut self, node: &TypedNode, pad: &Pad) -> Lowered<()> {
        let PadMode::Constant(fill) = &pad.mode else { return self.moved(node, &[0]) };
        let fill = numbers(fill);
        let fill = fill.ok_or_else(|| self.unsupported(node, "it is filled with no number"))?;
        let (value, shape) = (self.operand(node, 0)?, self.shape(node, 0)?);
        let (steps, own) = (strides(&value.shape), strides(&shape));
        let whole = self.arena.place(shape.iter().product());
        let around = self.stored(&fill);
        let all = Dimension { size: whole.len as usize, from: 0, to: 1 };
        self.arrange(node, around, whole, &[all])?;
        let skipped = pad.pads.iter().zip(&own).map(|((before, _), step)| before * step);
        let skipped = skipped.sum::<usize>() as u32;
        let inside = Place { offset: whole.offset + skipped, len: whole.len - skipped };
        let dimensions: Vec<Dimension> = (0..shape.len())
            .map(|axis| Dimension { size: value.shape[axis], from: steps[axis], to: own[axis] })
            .collect();
        self.arrange(node, value.place, inside, &dimensions)?;
        self.give(node, 0, whole)
    }

    /// Rows of zeros but for a one, each where a number says.
    pub(super) fn one_hot(&mut self, node: &TypedNode, hot: &OneHot) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let numbers = [&hot.off, &hot.on].map(|tensor| numbers(tensor));
        let is_plain = numbers == [Some(vec![0.0]), Some(vec![1.0])];
        let is_last = value.shape[hot.axis..].iter().all(|size| *size == 1);
        if !is_plain || !is_last {
            let hint = "plans have rows of zeros and a one along the last axis";
            return Err(self.unsupported(node, hint));
        }
        let place = self.hot(node, value.place, hot.dim)?;
        self.give(node, 0, place)
    }

    /// A row of so many numbers for each index: 1 where the index says, else 0. Indices may count from the end.
    pub(super) fn hot(&mut self, node: &TypedNode, indices: Place, size: usize) -> Lowered<Place> {
        let repeated = self.arena.place(indices.len as usize * size);
        let of = |size, from, to| Dimension { size, from, to };
        let dimensions = [of(indices.len as usize, 1, size), of(size, 0, 1)];
        self.arrange(node, indices, repeated, &dimensions)?;
        let mut is_at = |first: f32| {
            let places: Vec<f32> = (0..size).map(|place| place as f32 + first).collect();
            let places = self.stored(&places.repeat(indices.len as usize));
            self.combine(Combination::Equal, places, repeated)
        };
        let (from_start, from_end) = (is_at(0.0), is_at(-(size as f32)));
        Ok(self.combine(Combination::Or, from_start, from_end))
    }

    /// Rows of a table where the numbers of the rows are computed: the same ones along all axes before theirs.
    pub(super) fn looked_up(&mut self, node: &TypedNode, axis: usize) -> Lowered<()> {
        let (constant, tables) = match self.table(node)? {
            Some(table) => (Flag::Yes, table),
            None => (Flag::No, self.operand(node, 0)?),
        };
        let indices = self.operand(node, 1)?.place;
        let size = |axes: &[usize]| axes.iter().product::<usize>();
        let (before, after) = (size(&tables.shape[..axis]), size(&tables.shape[axis + 1..]));
        let mut repeated = indices;
        if before > 1 {
            repeated = self.arena.place(before * indices.len as usize);
            let of = |size, from, to| Dimension { size, from, to };
            let each = indices.len as usize;
            self.arrange(node, indices, repeated, &[of(before, 0, each), of(each, 1, 1)])?;
        }
        let to = self.arena.place(repeated.len as usize * after);
        let [rows, columns] = [tables.shape[axis], after].map(|size| size as u32);
        let (choice, tables, indices) = (Choice::Any, tables.place, repeated);
        self.ops.push(Op::LookUp(LookUp { choice, constant, tables, rows, columns, indices, to }));
        self.give(node, 0, to)
    }

    /// What a node takes rows of, among the weights, if it is constant.
    fn table(&mut self, node: &TypedNode) -> Lowered<Option<Value>> {
        let constant = self.constant(self.outlet(node, 0)?);
        let table = constant.and_then(|tensor| Some((numbers(&tensor)?, tensor.shape().to_vec())));
        Ok(table.map(|(numbers, shape)| Value { place: self.stored_table(&numbers), shape }))
    }

    /// Parts of a value whose numbers are constant.
    pub(super) fn gather(&mut self, node: &TypedNode, axis: usize) -> Lowered<()> {
        let indices = self.outlet(node, 1)?;
        let indices = self.constant(indices).and_then(|tensor| numbers(&tensor));
        let Some(indices) = indices else { return self.looked_up(node, axis) };
        let value = self.operand(node, 0)?;
        let size = value.shape[axis];
        let index = |index: &f32| if *index < 0.0 { *index + size as f32 } else { *index } as usize;
        let mut one = value.shape.clone();
        one[axis] = 1;
        if let [only] = indices.as_slice() {
            let place = self.part(node, &value, axis, index(only), &one)?;
            return self.give(node, 0, place);
        }
        let mut shape = value.shape.clone();
        shape[axis] = indices.len();
        let (own, steps) = (strides(&shape), strides(&value.shape));
        let whole = self.arena.place(shape.iter().product());
        for (place, taken) in indices.iter().map(index).enumerate() {
            let dimensions: Vec<Dimension> = (0..shape.len())
                .map(|axis| Dimension { size: one[axis], from: steps[axis], to: own[axis] })
                .collect();
            let part = |place: Place, start: usize| Place {
                offset: place.offset + start as u32,
                len: place.len.saturating_sub(start as u32),
            };
            let from = part(value.place, taken * steps[axis]);
            self.arrange(node, from, part(whole, place * own[axis]), &dimensions)?;
        }
        self.give(node, 0, whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dimensions_that_follow_each_other_are_one() {
        let d = |size, from, to| Dimension { size, from, to };
        assert_eq!(strides(&[2, 3, 4]), [12, 4, 1]);
        assert_eq!(merged(&[d(2, 12, 12), d(3, 4, 4), d(4, 1, 1)]), [d(24, 1, 1)]);
        assert_eq!(merged(&[d(2, 12, 12), d(1, 9, 9), d(4, 1, 3)]), [d(2, 12, 12), d(4, 1, 3)]);
        assert_eq!(merged(&[d(5, 0, 4), d(4, 1, 1)]), [d(5, 0, 4), d(4, 1, 1)]);
    }
}
