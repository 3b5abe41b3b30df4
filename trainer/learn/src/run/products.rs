//! With which instructions a run computes its matrix products: `run.products`.

use std::path::Path;

use sortie_nn::layers::products::Products;

use super::{RunConfig, RunFolder};
use crate::error::LearnError;

/// What `run.products` says where the processor decides.
const WIDEST: &str = "widest";

impl RunConfig {
    /// Writes in the place of `widest` what that is on this processor, and refuses what it does not have.
    pub fn settle_products(&mut self) -> Result<(), LearnError> {
        if self.products == WIDEST {
            self.products = Products::widest().to_string();
        }
        self.settled_products().map(drop)
    }

    /// The products of a run, if this processor has them.
    pub fn settled_products(&self) -> Result<Products, LearnError> {
        let here = Products::widest();
        match self.products.parse() {
            _ if self.products == WIDEST => Ok(here),
            Ok(products) if Products::are_available(products) => Ok(products),
            _ => {
                Err(LearnError::Products { asked: self.products.clone(), widest: here.to_string() })
            }
        }
    }
}

/// Has the run in a folder go on with the widest products of this processor where it lacks those that the run
/// learns with; says which it takes instead.
pub fn replace_products(folder: &Path) -> Result<Option<String>, LearnError> {
    let files = RunFolder::claim(folder)?;
    let mut description = files.read_description()?;
    let run = &mut description.config.run;
    if run.settled_products().is_ok() {
        return Ok(None);
    }
    run.products = Products::widest().to_string();
    let products = run.products.clone();
    files.rewrite_description(&description)?;
    Ok(Some(products))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_widest_gets_its_name_and_what_is_not_there_is_refused() {
        let mut run = RunConfig::default();
        run.settle_products().unwrap();
        assert_eq!(run.products, Products::widest().to_string());
        for products in Products::ALL {
            run.products = products.to_string();
            assert_eq!(run.settle_products().is_ok(), products.are_available());
        }
        run.products = "avx1024".to_owned();
        let error = run.settle_products().unwrap_err().to_string();
        let widest = format!("run.products={}", Products::widest());
        assert!(error.contains("avx1024") && error.contains(&widest), "{error}");
    }
}
