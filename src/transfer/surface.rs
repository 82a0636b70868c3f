//! How surfaces reflect (Kroes et al. 2012, hybrid scattering): four more channels of the transfer function.

use super::{Table, tabulate};
use crate::scene::TransferKeys;

/// For each entry of a table: diffuse and specular reflection, roughness, index of refraction.
pub fn surfaces(keys: &TransferKeys) -> Vec<[f32; 4]> {
    let columns = [&keys.diffuse, &keys.specular, &keys.roughness, &keys.ior].map(|points| tabulate(points));
    (0..Table::ENTRIES).map(|i| std::array::from_fn(|c| columns[c][i] as f32)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_linear_between_their_points() {
        let keys = TransferKeys {
            diffuse: vec![[0.0, 0.5]],
            roughness: vec![[0.0, 0.0], [1.0, 1.0]],
            ior: vec![[0.0, 1.0], [0.5, 1.0], [0.5, 2.0]],
            ..Default::default()
        };
        let columns = surfaces(&keys);
        assert_eq!(columns.len(), Table::ENTRIES);
        assert_eq!((columns[0], columns[1023]), ([0.5, 1.0, 0.0, 1.0], [0.5, 1.0, 1.0, 2.0]));
        assert!((columns[341][2] - 341.0 / 1023.0).abs() < 1e-6);
    }
}
