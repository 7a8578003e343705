//! Numbers that may be unknown, and labels, as the file holds them.

/// A number that may be unknown: `NaN` or infinite in memory, `null` in the file.
pub(super) mod maybe {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(in crate::record) fn serialize<S: Serializer>(x: &f64, s: S) -> Result<S::Ok, S::Error> {
        x.is_finite().then_some(*x).serialize(s)
    }
    pub(in crate::record) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<f64, D::Error> {
        Ok(Option::<f64>::deserialize(d)?.unwrap_or(f64::NAN))
    }
    pub(in crate::record) fn unknown() -> f64 {
        f64::NAN
    }
}

/// As [`maybe`], for fixed arrays.
pub(super) mod maybe_array {
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::DeserializeOwned};

    pub(in crate::record) fn serialize<S: Serializer, const N: usize>(x: &[f64; N], s: S) -> Result<S::Ok, S::Error>
    where
        [Option<f64>; N]: Serialize,
    {
        x.map(|x| x.is_finite().then_some(x)).serialize(s)
    }
    pub(in crate::record) fn deserialize<'de, D: Deserializer<'de>, const N: usize>(d: D) -> Result<[f64; N], D::Error>
    where
        [Option<f64>; N]: DeserializeOwned,
    {
        Ok(<[Option<f64>; N]>::deserialize(d)?.map(|x| x.unwrap_or(f64::NAN)))
    }
    pub(in crate::record) fn unknown<const N: usize>() -> [f64; N] {
        [f64::NAN; N]
    }
}

/// As [`maybe`], for lists.
pub(super) mod maybe_list {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(in crate::record) fn serialize<S: Serializer>(x: &[f64], s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(x.iter().map(|x| x.is_finite().then_some(*x)))
    }
    pub(in crate::record) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Vec<f64>, D::Error> {
        Ok(Vec::<Option<f64>>::deserialize(d)?.into_iter().map(|x| x.unwrap_or(f64::NAN)).collect())
    }
    #[derive(Serialize, Deserialize)]
    pub(in crate::record) struct Row(#[serde(with = "self")] pub(in crate::record) Vec<f64>);
}

/// As [`maybe`], for matrices as lists of rows.
pub(super) mod maybe_rows {
    use super::maybe_list::Row;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(in crate::record) fn serialize<S: Serializer>(x: &[Vec<f64>], s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(x.iter().map(|row| Row(row.clone())))
    }
    pub(in crate::record) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Vec<Vec<f64>>, D::Error> {
        Ok(Vec::<Row>::deserialize(d)?.into_iter().map(|row| row.0).collect())
    }
}

/// As [`maybe`], for numbers by name.
pub(super) mod maybe_map {
    use serde::{Deserialize, Deserializer, Serializer};
    use std::collections::BTreeMap;

    pub(in crate::record) fn serialize<S: Serializer>(x: &BTreeMap<String, f64>, s: S) -> Result<S::Ok, S::Error> {
        s.collect_map(x.iter().map(|(k, x)| (k, x.is_finite().then_some(*x))))
    }
    pub(in crate::record) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<BTreeMap<String, f64>, D::Error> {
        let map = BTreeMap::<String, Option<f64>>::deserialize(d)?;
        Ok(map.into_iter().map(|(k, x)| (k, x.unwrap_or(f64::NAN))).collect())
    }
}

/// A dot's label: column, row, level.
pub(super) mod label {
    use crate::target::DotId;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(in crate::record) fn serialize<S: Serializer>(id: &DotId, s: S) -> Result<S::Ok, S::Error> {
        (id.column, id.row, id.level).serialize(s)
    }
    pub(in crate::record) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<DotId, D::Error> {
        let (column, row, level) = <(i32, i32, u8)>::deserialize(d)?;
        Ok(DotId { column, row, level })
    }
}
