"""Surface models beside VDM, to judge it by: boundary elements and springs. No form of VDM imports them."""
