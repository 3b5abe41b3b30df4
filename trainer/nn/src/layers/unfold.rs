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
