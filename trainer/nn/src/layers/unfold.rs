//! Pictures taken apart into the patches that a kernel sees: what makes a convolution a linear layer.
//!
//! A picture is a row `[height, width, channels]`; behind each other in a patch stand the kernel's rows,
//! their columns, and the channels of each. No padding.

/// Sizes of pictures and of the kernel that goes over them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnfoldShape {
    /// Rows of a picture.
    pub height: usize,
    /// Columns of a picture.
    pub width: usize,
    /// Numbers of a point.
    pub channels: usize,
    /// Side of the square kernel, at most height and width.
    pub kernel: usize,
    /// Points from one patch to the next.
    pub stride: usize,
}

impl UnfoldShape {
    /// Rows and columns of the patches of one picture.
    pub fn patches(self) -> (usize, usize) {
        let count = |side: usize| (side - self.kernel) / self.stride + 1;
        (count(self.height), count(self.width))
    }

    /// Numbers of a patch.
    pub fn patch(self) -> usize {
        self.kernel * self.kernel * self.channels
    }

    /// Numbers of a picture.
    pub fn picture(self) -> usize {
        self.height * self.width * self.channels
    }

    /// Where in its picture each line of each patch begins, in the order of the patches.
    fn lines(self) -> impl Iterator<Item = usize> {
        let (down, across) = self.patches();
        let patches = (0..down).flat_map(move |i| (0..across).map(move |j| (i, j)));
        patches.flat_map(move |(i, j)| {
            let corner = (i * self.width + j) * self.stride;
            (0..self.kernel).map(move |line| (corner + line * self.width) * self.channels)
        })
    }
}

/// Writes the patches `[pictures * patches, patch]`.
pub fn forward(shape: UnfoldShape, x: &[f32], y: &mut [f32]) {
    let line = shape.kernel * shape.channels;
    let (down, across) = shape.patches();
    let pictures = x.chunks_exact(shape.picture());
    for (x, y) in pictures.zip(y.chunks_exact_mut(down * across * shape.patch())) {
        for (start, y) in shape.lines().zip(y.chunks_exact_mut(line)) {
            y.copy_from_slice(&x[start..][..line]);
        }
    }
}

/// Adds to the slopes of the pictures those of their patches.
pub fn backward(shape: UnfoldShape, d_y: &[f32], d_x: &mut [f32]) {
    let line = shape.kernel * shape.channels;
    let (down, across) = shape.patches();
    let pictures = d_x.chunks_exact_mut(shape.picture());
    for (d_x, d_y) in pictures.zip(d_y.chunks_exact(down * across * shape.patch())) {
        for (start, d_y) in shape.lines().zip(d_y.chunks_exact(line)) {
            d_x[start..][..line].iter_mut().zip(d_y).for_each(|(d_x, d_y)| *d_x += d_y);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rows of three patches, a stride apart both ways; the last row of the picture belongs to none.
    const SHAPE: UnfoldShape =
        UnfoldShape { height: 6, width: 7, channels: 2, kernel: 3, stride: 2 };

    #[test]
    fn patches_are_a_stride_apart_down_and_across() {
        assert_eq!(SHAPE.patches(), (2, 3));
        let pictures: Vec<f32> = (0..2 * SHAPE.picture()).map(|number| number as f32).collect();
        let mut patches = vec![f32::NAN; 2 * 6 * SHAPE.patch()];
        forward(SHAPE, &pictures, &mut patches);
        let mut found = patches.iter();
        let mut times_seen = vec![0.0; pictures.len()];
        for picture in 0..2 {
            for (corner_row, corner_column) in [(0, 0), (0, 2), (0, 4), (2, 0), (2, 2), (2, 4)] {
                for (row, column, channel) in (0..18).map(|at| (at / 6, at / 2 % 3, at % 2)) {
                    let point = (corner_row + row) * 7 + corner_column + column;
                    let number = (picture * 6 * 7 + point) * 2 + channel;
                    assert_eq!(found.next(), Some(&pictures[number]));
                    times_seen[number] += 1.0;
                }
            }
        }
        // Slopes go back to where the numbers came from.
        let mut slopes = vec![0.0; pictures.len()];
        backward(SHAPE, &vec![1.0; patches.len()], &mut slopes);
        assert_eq!(slopes, times_seen);
    }
}
