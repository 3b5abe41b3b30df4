//! Checked access to JSON: every refusal names the field.

use std::ops::RangeInclusive;

use serde_json::Value;

use super::error::GoldenError;

/// A value and the path that leads to it.
#[derive(Clone)]
pub(crate) struct Field<'a> {
    value: &'a Value,
    path: String,
}

impl<'a> Field<'a> {
    pub(crate) fn root(value: &'a Value) -> Self {
        Self { value, path: String::new() }
    }

    pub(crate) fn value(&self) -> &'a Value {
        self.value
    }

    pub(crate) fn path(&self) -> &str {
        &self.path
    }

    /// A member of this object, if it is there.
    pub(crate) fn find(&self, name: &str) -> Result<Option<Self>, GoldenError> {
        let object = self.value.as_object().ok_or_else(|| self.refuse("is not an object"))?;
        let path = if self.path.is_empty() { name.into() } else { format!("{}.{name}", self.path) };
        Ok(object.get(name).map(|value| Self { value, path }))
    }

    /// A member that this object must have.
    pub(crate) fn get(&self, name: &str) -> Result<Self, GoldenError> {
        self.find(name)?.ok_or_else(|| {
            let path = &self.path;
            let dot = if path.is_empty() { "" } else { "." };
            GoldenError::field(format!("{path}{dot}{name}"), "is missing")
        })
    }

    /// The items of this list.
    pub(crate) fn items(&self) -> Result<Vec<Self>, GoldenError> {
        let list = self.value.as_array().ok_or_else(|| self.refuse("is not a list"))?;
        let item = |(index, value)| Self { value, path: format!("{}[{index}]", self.path) };
        Ok(list.iter().enumerate().map(item).collect())
    }

    /// The items of this list, which must be so many.
    pub(crate) fn exactly(&self, count: usize) -> Result<Vec<Self>, GoldenError> {
        let items = self.items()?;
        if items.len() != count {
            let found = items.len();
            return Err(self.refuse(format!("has {found} entries instead of {count}")));
        }
        Ok(items)
    }

    pub(crate) fn number(&self) -> Result<f64, GoldenError> {
        self.value.as_f64().ok_or_else(|| self.refuse("is not a number"))
    }

    pub(crate) fn integer(&self, range: RangeInclusive<u64>) -> Result<u64, GoldenError> {
        let (low, high) = (range.start(), range.end());
        self.value
            .as_u64()
            .filter(|value| range.contains(value))
            .ok_or_else(|| self.refuse(format!("is not an integer from {low} to {high}")))
    }

    pub(crate) fn flag(&self) -> Result<bool, GoldenError> {
        self.value.as_bool().ok_or_else(|| self.refuse("is neither true nor false"))
    }

    pub(crate) fn text(&self) -> Result<&'a str, GoldenError> {
        self.value.as_str().ok_or_else(|| self.refuse("is not a text"))
    }

    /// What a single letter stands for.
    pub(crate) fn letter<T>(&self, meaning: fn(char) -> Option<T>) -> Result<T, GoldenError> {
        let mut letters = self.text()?.chars();
        match (letters.next().and_then(meaning), letters.next()) {
            (Some(meaning), None) => Ok(meaning),
            _ => Err(self.refuse("is not the letter of a type")),
        }
    }

    pub(crate) fn refuse(&self, reason: impl Into<String>) -> GoldenError {
        let path = if self.path.is_empty() { "(the whole file)" } else { &self.path };
        GoldenError::field(path, reason)
    }
}
