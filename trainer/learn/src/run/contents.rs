//! The large files of a checkpoint, in parts: what they hold is too much to stand in memory twice.

use std::collections::BTreeMap;
use std::error::Error;

use safetensors::tensor::{Dtype, Metadata, TensorInfo};

/// Name, sizes and numbers of a tensor, as the file has them.
pub(crate) type SavedTensor = (String, Vec<usize>, Vec<u8>);

/// What is written one behind the other, each with what stands before it.
#[derive(Debug)]
pub(super) struct Contents<'a>(Vec<(Vec<u8>, &'a [u8])>);

impl<'a> Contents<'a> {
    /// Tensors as a file of `safetensors` has them: a header, and their bytes in the order of their names.
    pub(super) fn of_tensors(tensors: &'a [SavedTensor]) -> Result<Self, Box<dyn Error>> {
        let mut sorted: Vec<&SavedTensor> = tensors.iter().collect();
        sorted.sort_by_key(|(name, ..)| name);
        let mut end = 0;
        let infos = sorted.iter().map(|(name, sizes, bytes)| {
            let data_offsets = (end, end + bytes.len());
            end = data_offsets.1;
            (name.clone(), TensorInfo { dtype: Dtype::F32, shape: sizes.clone(), data_offsets })
        });
        let mut text = serde_json::to_vec(&Metadata::new(None, infos.collect())?)?;
        text.resize(text.len().next_multiple_of(8), b' ');
        let length = (text.len() as u64).to_le_bytes();
        let mut parts = vec![(length.to_vec(), &[][..]), (text, &[])];
        parts.extend(sorted.into_iter().map(|(.., bytes)| (Vec::new(), bytes.as_slice())));
        Ok(Self(parts))
    }

    /// Values as postcard writes a map: how many there are, and behind each name how long its value is.
    pub(super) fn of_values(values: &'a BTreeMap<String, Vec<u8>>) -> postcard::Result<Self> {
        let mut parts = vec![(postcard::to_stdvec(&values.len())?, &[][..])];
        for (name, value) in values {
            let mut before = postcard::to_stdvec(name)?;
            before.extend(postcard::to_stdvec(&value.len())?);
            parts.push((before, value));
        }
        Ok(Self(parts))
    }

    /// All of it in its order.
    pub(super) fn parts(&self) -> impl Iterator<Item = &[u8]> + Clone {
        self.0.iter().flat_map(|(before, part)| [before.as_slice(), part])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use safetensors::tensor::TensorView;

    #[test]
    fn files_in_parts_are_those_of_their_formats() {
        let tensor = |name: &str, sizes: [usize; 2], first: u8| -> SavedTensor {
            (name.to_owned(), sizes.to_vec(), (first..).take(4 * sizes[0] * sizes[1]).collect())
        };
        let tensors = [tensor("b/fc1", [2, 3], 1), tensor("a", [1, 5], 50), tensor("b", [0, 3], 0)];
        let whole = |contents: Contents<'_>| contents.parts().collect::<Vec<_>>().concat();
        let views = tensors.iter().map(|(name, sizes, bytes)| {
            (name, TensorView::new(Dtype::F32, sizes.clone(), bytes).unwrap())
        });
        let file = safetensors::serialize(views, None).unwrap();
        assert_eq!(whole(Contents::of_tensors(&tensors).unwrap()), file);
        assert_eq!(whole(Contents::of_tensors(&[]).unwrap()).len() % 8, 0);

        let values = BTreeMap::from([("steps", vec![1; 300]), ("a", vec![])]);
        let values = values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let file = postcard::to_stdvec(&values).unwrap();
        assert_eq!(whole(Contents::of_values(&values).unwrap()), file);
    }
}
